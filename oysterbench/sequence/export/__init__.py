"""Sequences in the formats of others, a file per format."""
