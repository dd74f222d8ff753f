"""Doors to recordings: whatever the files look like, a `StereoSource` of `StereoPair`s comes out."""

from roadblock.io.sources.opening import SOURCES, open_source
from roadblock.io.sources.source import ImagePairs, StereoSource
from roadblock.io.sources.video import VideoSource

__all__ = ["SOURCES", "ImagePairs", "StereoSource", "VideoSource", "open_source"]
