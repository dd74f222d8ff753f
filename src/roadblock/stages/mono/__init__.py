"""Mono: one rectified image in; road plane, outlines and ranges out. The two traditional algorithms of table 2."""

from roadblock.stages.mono.settings import AUTO, BUILDS, Build, MonoSettings

__all__ = ["AUTO", "BUILDS", "Build", "MonoSettings"]
