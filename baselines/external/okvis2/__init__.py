"""OKVIS2."""
