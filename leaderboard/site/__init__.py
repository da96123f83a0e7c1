"""The pages of the board, their representations for programs, and the static export."""
