"""The migration steps, named in their order."""
