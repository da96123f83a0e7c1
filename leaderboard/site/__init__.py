"""The pages of the board, their twins for programs, and the static export."""
