"""Foundations of all other packages: errors, files, geometry, named random streams, measurements, trajectories."""
