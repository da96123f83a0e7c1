"""Sensors: truth in, measurement out."""
