"""Results: records, and methods set against each other."""
