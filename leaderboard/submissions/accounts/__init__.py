"""Teams and tokens, sign-in, and limits of rates."""
