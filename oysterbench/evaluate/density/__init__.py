"""Scoring maps of oysters against the true ones."""
