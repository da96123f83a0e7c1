"""What rendered images add: trainings with more and more real ones, with and without them."""
