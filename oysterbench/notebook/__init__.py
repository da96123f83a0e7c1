"""Functions for use in a notebook: open a split by its name, score two files, map oysters, check the machine."""
