"""Adapters to published systems."""
