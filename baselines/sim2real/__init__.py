"""What rendered images are worth: trainings with more and more real ones, with and without them."""
