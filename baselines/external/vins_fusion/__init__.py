"""VINS-Fusion."""
