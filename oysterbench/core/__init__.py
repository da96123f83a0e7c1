"""Foundations of all other packages.

mathematics    geometry, trajectory, measurements, streams (named random streams), polygons
files          places (where data is), atomic (writing), locks, permissions, disk_space, mcap, ros, ply, pictures
input          errors, names (did you mean), text and masks (from untrusted sources)
output         html, page, templates, display (of objects in notebooks)
machines       hardware (of this one), cluster (Dask)
"""
