"""The expert, which sees the ground truth: where it may go, what it has seen, its commands, and labels from them."""
