"""The pages: from the index and some arguments to a `Page`, with no server in between."""
