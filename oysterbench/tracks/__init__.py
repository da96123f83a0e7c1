"""The tracks, run: methods over the sequences of a split, each answer scored and recorded."""
