"""What every room stands on: errors, files, geometry, named random streams, measurements, trajectories."""
