"""Scoring oyster maps against the ground truth."""
