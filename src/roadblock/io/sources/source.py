"""What every source of image pairs offers, and the one for image files on disk."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

from roadblock.errors import SourceError
from roadblock.io.sources.image import read_image
from roadblock.io.sources.pairing import FramePaths
from roadblock.values.camera import StereoRig
from roadblock.values.checks import FloatArray
from roadblock.values.frame import Image, StereoPair


class StereoSource(Protocol):
    """A recording: iterate it, as often as needed, for its pairs. What it lacks is None, never absent.

    Attributes
    ----------
    name
        Short name of the recording.
    rig
        The cameras; of the first frame where `rigs` is given.
    rigs
        One rig per frame (`rigs[pair.index]`; equal ones are one object) where the recording holds frames of several
        rigs, else None.
    ground_truth
        File or folder with the truth of what stands on the road, or None.
    length
        Number of pairs, or None where only reading to the end can tell.
    is_sequence
        Whether the pairs follow each other in time, so that `t_ns` means something and tracking makes sense.
    warnings
        What the latest iteration passed over, one line each; empty for a whole recording.
    """

    @property
    def name(self) -> str: ...  # noqa: D102
    @property
    def rig(self) -> StereoRig: ...  # noqa: D102
    @property
    def rigs(self) -> tuple[StereoRig, ...] | None: ...  # noqa: D102
    @property
    def ground_truth(self) -> Path | None: ...  # noqa: D102
    @property
    def length(self) -> int | None: ...  # noqa: D102
    @property
    def is_sequence(self) -> bool: ...  # noqa: D102
    @property
    def warnings(self) -> list[str]: ...  # noqa: D102
    def __iter__(self) -> Iterator[StereoPair]: ...


@dataclass(frozen=True, eq=False)
class ImagePairs:
    """A `StereoSource` of image files, read one pair at a time.

    Attributes
    ----------
    frames
        The files of each pair, in order.
    gray
        Whether colour is turned into grey.
    poses
        (4, 4) `T_odom_left` of each pair, or None where the recording says nothing about them.
    name, rig, rigs, ground_truth, is_sequence, warnings
        As in `StereoSource`.
    """

    name: str
    rig: StereoRig
    frames: tuple[FramePaths, ...]
    is_sequence: bool = False
    rigs: tuple[StereoRig, ...] | None = None
    ground_truth: Path | None = None
    gray: bool = False
    warnings: list[str] = field(default_factory=list)
    poses: tuple[FloatArray, ...] | None = None

    @property
    def length(self) -> int:
        """Number of pairs."""
        return len(self.frames)

    def __iter__(self) -> Iterator[StereoPair]:
        """Read the pairs in order.

        Raises
        ------
        SourceError
            If an image cannot be read, has another size than the rig, or differs from its partner in kind.
        """
        for index, frame in enumerate(self.frames):
            rig = self.rigs[index] if self.rigs else self.rig
            left, right = (read_image(path, gray=self.gray) for path in (frame.left, frame.right))
            check_size(str(frame.left), left, rig.left.size_px)
            check_size(str(frame.right), right, rig.right.size_px)
            if left.ndim != right.ndim or left.dtype != right.dtype:
                raise SourceError(
                    f"{frame.left} is {_kind(left)}, but its partner {frame.right} is {_kind(right)}: "
                    "both cameras must record alike"
                )
            T_odom_left = None if self.poses is None else self.poses[index]
            yield StereoPair(left, right, index, frame.name, frame.t_ns, T_odom_left)


def _kind(image: Image) -> str:
    return f"{8 * image.dtype.itemsize} bit {'grey' if image.ndim == 2 else 'colour'}"


def check_size(what: str, image: Image, size_px: tuple[int, int]) -> None:
    """Check that an image has the size its camera was calibrated for.

    Raises
    ------
    SourceError
        If it has not.
    """
    height, width = image.shape[:2]
    if (width, height) != size_px:
        raise SourceError(
            f"{what} is {width}x{height}, but its rig is for {size_px[0]}x{size_px[1]}: "
            "calibrate at the size you record, or choose the right rig with --rig FILE"
        )
