"""Uploads, read in place and checked."""
