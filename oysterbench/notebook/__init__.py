"""What is typed in a notebook: a split by its name, the score of two files, and how the machine is."""
