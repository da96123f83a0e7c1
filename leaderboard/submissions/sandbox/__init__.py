"""Reading and scoring uploads in processes that can do nothing else."""
