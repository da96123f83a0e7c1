"""The steps, named in their order."""
