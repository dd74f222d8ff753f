"""roadblock: every obstacle on the road, from any two cameras."""

from importlib.metadata import version

__version__ = version("roadblock")
