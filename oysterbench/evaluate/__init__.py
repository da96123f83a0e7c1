"""Evaluators: each scores an estimate against the ground truth."""
