"""Records and what belongs to them, as files named by their hash."""
