"""The test of low obstacles as plain numpy: slow, short, and what `low_compiled` must reproduce to rounding."""

CHUNK = 32
CLIP = 9.0
LINEAR = 1 / 3
TOLERANCE_PX = 0.1
ALIKE = (1.0, 2 / 3, 1 / 6, 0.0, 0.0)
CORRELATED = 1.94
