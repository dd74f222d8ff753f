"""The KITTI layouts: single rectified frames (object, stereo 2012 and 2015, road), raw drives, odometry.

Each comes in a grey kind (cameras 0 and 1) and a colour kind (cameras 2 and 3).
"""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

from roadblock.errors import SourceError
from roadblock.io.rig import read_kitti_object, read_kitti_odometry, read_kitti_raw
from roadblock.io.sources.folders import sides_of, stamp
from roadblock.io.sources.image import image_size
from roadblock.io.sources.kitti_poses import read_oxts, read_poses
from roadblock.io.sources.pairing import FramePaths, pair_folders
from roadblock.io.sources.source import ImagePairs, StereoSource
from roadblock.values.camera import StereoRig

Pair = tuple[int, int]
"""Numbers of the left and the right camera."""

GRAY: Pair = (0, 1)
COLOR: Pair = (2, 3)
FLAT_SIDES = {
    GRAY: (("image_0", "image_1"), ("image_00", "image_01")),
    COLOR: (("image_2", "image_3"), ("image_02", "image_03"), ("colored_0", "colored_1")),
}
RAW_SIDES = {GRAY: (("image_00/data", "image_01/data"),), COLOR: (("image_02/data", "image_03/data"),)}
TRUTH = ("disp_occ_0", "disp_occ")
CALIB_FOLDERS = ("calib", "calib_cam_to_cam")
NOMINAL_STEP_NS = 100_000_000
"""KITTI's published frame rate is 10 Hz; only used where an odometry sequence comes without times.txt."""


def _is_odometry(path: Path) -> bool:
    return (path / "times.txt").is_file() or (path / "poses.txt").is_file()


def _is_raw(path: Path, pair: Pair) -> bool:
    return bool(sides_of(path, RAW_SIDES[pair]))


def is_kitti(layout: str, pair: Pair, path: Path) -> bool:
    """Whether a folder has a KITTI layout ("stills", "raw" or "odometry") for a pair of cameras."""
    if layout == "raw":
        return _is_raw(path, pair)
    flat = bool(sides_of(path, FLAT_SIDES[pair])) and not _is_raw(path, pair)
    return flat and _is_odometry(path) == (layout == "odometry")


def _frames(path: Path, table: tuple[tuple[str, str], ...]) -> tuple[FramePaths, ...]:
    sides = sides_of(path, table)
    if len(sides) != 1:
        names = " or ".join(f"{left}+{right}" for left, right in table)
        raise SourceError(f"{path} must hold one of {names}, but holds {len(sides)} of them")
    return pair_folders(*sides[0])


def open_stills(pair: Pair, path: Path, rig: StereoRig | None, gray: bool) -> StereoSource:
    """Open single rectified frames with one `calib.txt`, or one calibration per frame in `calib/`.

    Frames of one recording may come from several rigs (each day of KITTI has its own); then the source has `rigs`.
    Two frames of one scene (`000000_10`, `000000_11`) stay single frames.

    Raises
    ------
    SourceError
        If an image lacks its partner or a frame has no calibration.
    RigError, ValueRefusedError
        If a calibration cannot be trusted.
    """
    frames = _frames(path, FLAT_SIDES[pair])
    rigs = None
    if rig is None and not (path / "calib.txt").is_file():
        rigs = _rig_per_frame(path, frames, pair)
        rig = rigs[0]
        rigs = rigs if any(other is not rig for other in rigs) else None
    truth = (path / name for name in TRUTH)
    return ImagePairs(
        name=path.resolve().name,
        rig=rig or read_kitti_odometry(path / "calib.txt", pair=pair, size_px=image_size(frames[0].left)),
        frames=frames,
        rigs=rigs,
        ground_truth=next((folder for folder in truth if folder.is_dir()), None),
        gray=gray,
    )


def _rig_per_frame(path: Path, frames: tuple[FramePaths, ...], pair: Pair) -> tuple[StereoRig, ...]:
    """One rig per frame; frames whose calibration and size are equal share one object."""
    known: dict[tuple[object, ...], StereoRig] = {}
    rigs = []
    for frame in frames:
        names = dict.fromkeys((frame.name, frame.name.rpartition("_")[0] or frame.name))
        files = [path / folder / f"{name}.txt" for folder in CALIB_FOLDERS for name in names]
        file = next((file for file in files if file.is_file()), None)
        if file is None:
            raise SourceError(
                f"{path} holds neither calib.txt nor calib/{frame.name}.txt: give the rig with --rig FILE"
            )
        read = read_kitti_object if file.parent.name == "calib" else partial(read_kitti_raw, rectified=True)
        rig = read(file, pair=pair, size_px=image_size(frame.left))
        rigs.append(known.setdefault(_numbers(rig), rig))
    return tuple(rigs)


def _numbers(rig: StereoRig) -> tuple[object, ...]:
    cameras = ((c.size_px, c.K.tobytes(), c.lens, c.distortion.tobytes()) for c in (rig.left, rig.right))
    return (*cameras, rig.T_left_right.tobytes())


def open_raw(pair: Pair, path: Path, rig: StereoRig | None, gray: bool) -> StereoSource:
    """Open a raw drive: `image_0N/data`, the left camera's `timestamps.txt`, `calib_cam_to_cam*.txt` in it or above.

    The size of the images decides whether they are the raw ones or the rectified ones. Grey pairs have poses where
    `oxts/` knows them (see `kitti_poses`) and no rig is given.

    Raises
    ------
    SourceError
        If an image lacks its partner, the time stamps do not fit, or there is not one calibration file.
    RigError, ValueRefusedError
        If the calibration cannot be trusted.
    """
    frames = _frames(path, RAW_SIDES[pair])
    stamps = frames[0].left.parents[1] / "timestamps.txt"
    if not stamps.is_file():
        raise SourceError(f"{stamps} is missing, but a raw drive needs it: copy it, or open it as a list of pairs")
    poses = None
    if rig is None:
        calibration = _raw_calibration(path)
        rig = read_kitti_raw(calibration, pair=pair, size_px=image_size(frames[0].left))
        poses = read_oxts(path, frames, calibration if rig.is_rectified else None) if pair == GRAY else None
    return ImagePairs(
        name=path.resolve().name,
        rig=rig,
        frames=stamp(frames, stamps),
        is_sequence=True,
        gray=gray,
        poses=poses,
    )


def _raw_calibration(path: Path) -> Path:
    for folder in (path, *path.resolve().parents[:2]):
        found = sorted(folder.glob("calib_cam_to_cam*.txt"))
        if len(found) > 1:
            names = ", ".join(file.name for file in found)
            raise SourceError(f"{folder} holds several calibrations ({names}): choose with --rig FILE")
        if found:
            return found[0]
    raise SourceError(
        f"{path} holds no calib_cam_to_cam*.txt, nor do the two folders above it: give the rig with --rig FILE"
    )


def open_odometry(pair: Pair, path: Path, rig: StereoRig | None, gray: bool) -> StereoSource:
    """Open an odometry sequence: `calib.txt`, `times.txt` (without it, the nominal 10 Hz from frame to frame).

    `poses.txt`, where it is, says where camera 0 was, so that only grey pairs have poses.

    Raises
    ------
    SourceError
        If an image lacks its partner, the time stamps or poses do not fit, or `calib.txt` is missing.
    RigError, ValueRefusedError
        If the calibration cannot be trusted.
    """
    frames = _frames(path, FLAT_SIDES[pair])
    calibration, times = path / "calib.txt", path / "times.txt"
    if rig is None and not calibration.is_file():
        raise SourceError(f"{calibration} is missing, but says how the cameras stand: give the rig with --rig FILE")
    if times.is_file():
        frames = stamp(frames, times)
    else:
        frames = tuple(replace(frame, t_ns=i * NOMINAL_STEP_NS) for i, frame in enumerate(frames))
    return ImagePairs(
        name=path.resolve().name,
        rig=rig or read_kitti_odometry(calibration, pair=pair, size_px=image_size(frames[0].left)),
        frames=frames,
        is_sequence=True,
        gray=gray,
        poses=read_poses(path / "poses.txt", frames) if pair == GRAY else None,
    )


Test = Callable[[Path], bool]
Opener = Callable[[Path, StereoRig | None, bool], StereoSource]

KITTI: tuple[tuple[str, Test, Opener], ...] = tuple(
    (f"kitti-{layout}-{color}", partial(is_kitti, layout, pair), partial(opener, pair))
    for layout, opener in (("stills", open_stills), ("raw", open_raw), ("odometry", open_odometry))
    for color, pair in (("gray", GRAY), ("color", COLOR))
)
"""Name, test and opener of each kind."""
