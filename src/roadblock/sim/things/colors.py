"""The colours things come in, by the name a person would say."""

from roadblock.sim.solids import Rgb

COLORS: dict[str, Rgb] = {
    "red": (186, 36, 34),
    "orange": (232, 116, 26),
    "yellow": (226, 186, 30),
    "green": (36, 124, 62),
    "blue": (38, 70, 170),
    "purple": (104, 52, 132),
    "brown": (112, 76, 50),
    "white": (226, 226, 222),
    "silver": (176, 180, 184),
    "grey": (112, 114, 118),
    "black": (38, 38, 42),
}

RUBBER: Rgb = (34, 34, 36)
STEEL: Rgb = (150, 154, 158)
GLASS: Rgb = (24, 30, 36)
CONCRETE: Rgb = (168, 164, 156)


def shaded(rgb: Rgb, factor: float) -> Rgb:
    """Return a colour `factor` times as bright, at most white."""
    red, green, blue = (min(255, round(level * factor)) for level in rgb)
    return red, green, blue
