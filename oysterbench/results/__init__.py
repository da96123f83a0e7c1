"""Results: their records, and comparisons of methods."""
