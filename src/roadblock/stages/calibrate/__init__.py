"""Calibrate: pictures of a board in, a rig with a known range error out (the paper's sections 2.1 and 3.2)."""
