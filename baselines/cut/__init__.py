"""Rendered pictures that look like real ones: contrastive unpaired translation, and the cheap controls beside it."""
