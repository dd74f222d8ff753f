"""The road under cells of disparity, readably."""

BIN_POINTS = 200
"""Points of each step ahead that are kept."""

POLISHED = 10
"""The best drawn planes that are fitted before the winner is chosen."""

GROWTH = 5
"""Steps from the near plane out to the end of the bend."""
