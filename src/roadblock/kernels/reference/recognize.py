"""The definition of what recognition measures of a region."""

CELLS, PITCH_CELLS = 160, 64
"""Of a thing at most so many cells are looked at, evenly spread; its first ones tell how far cells are apart."""
COLUMNS, LAYERS = 8, 6
"""Bins across and up a thing."""
CELLS_HIGH, CELLS_WIDE, TURNS, PATCH_STEP = 4, 3, 4, 6
"""Cells and directions of the histogram of gradients; it looks at so many places across and along each cell."""
BESIDE_PX, SIDES, FAR_M = 6.0, 12, 8.0
"""Free road is looked for so far beside a thing, over so many columns of free space, and up to this far behind."""
OWN = 16 + 2 * COLUMNS + 2 * LAYERS
LOOKS = CELLS_HIGH * CELLS_WIDE * TURNS + 1
FOOT_LOW_M = 0.8
"""A thing that begins lower is seen down to the road."""
TOGETHER_M, TOGETHER_SHARE, TOUCH_PX = 0.7, 0.04, 8.0
"""Things as near as each other, by so much or by such a share, with no larger gap between, may be pieces of one."""
FIGURES = OWN + LOOKS + 4 + 5 + LOOKS
"""How many figures there are of a thing."""

HUE_ENDS_DEG = (15.0, 50.0, 76.0, 112.0, 195.0, 308.0, 340.0)
"""Upper ends of the CIELAB hue angles of pink, red, orange, yellow, green, blue, purple; beyond the last it is pink."""
HUES = len(HUE_ENDS_DEG)
ROAD_ROWS = 8
"""The road is looked at in so many rows of a block before the vehicle."""
ROAD_L = 47.0
"""Lightness of asphalt under a white light of full strength."""
GAIN_LIMITS = (0.7, 2.0)
GREY_SHARE, GREY_LEAST = 0.16, 4.0
"""What has less chroma than this share of its lightness and so much more is grey."""
BODY_SHARE = 0.65
"""The body of a grey thing is as light as this share of its places: the rest is glass, tyres and shadow."""
BACKGROUND, SEEN_THROUGH = 24, 0.5
"""So many places beside a thing show what is behind it; such a share of it is taken off, as if seen through it."""
COLOR_FIGURES = 4 * HUES + 6
"""How many figures there are of a thing's colours."""

ROWS = 48
"""A contour has at most so many rows."""
REACH_PX, EDGE_LEVELS = 3.0, 6.0
"""An edge of the image so far beyond a cell's edge, and of so many grey levels, is the thing's."""
FOOT_M = 0.6
"""What begins lower stands on the road and is seen down to it."""
HEADINGS, POINTS = 18, 96
"""Directions in a right angle and places of a thing's surface that its outline on the road is fitted with."""
STRAY_FROM = 20
"""Of more places than these the outermost on each side is a stray one."""
OUTLINE_FIGURES = 7
