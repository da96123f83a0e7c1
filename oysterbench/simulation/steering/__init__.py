"""The expert that sees the truth: where it may go, what it has seen, what it commands, and labels made of that."""
