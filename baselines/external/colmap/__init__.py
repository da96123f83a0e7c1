"""COLMAP."""
