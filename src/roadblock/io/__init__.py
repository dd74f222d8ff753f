"""Doors: rig files, sources of image pairs, sinks of results. A door converts and nothing else."""
