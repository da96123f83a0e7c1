"""From a recipe to sequence files: simulated sequences, their sensors, and the jobs that make them."""
