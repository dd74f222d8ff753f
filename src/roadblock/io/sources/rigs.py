"""The rig file that lies beside a recording."""

from pathlib import Path

from roadblock.errors import SourceError
from roadblock.io.rig import read_rig
from roadblock.values.camera import StereoRig

RIG_FILES = ("rig.yaml", "left.yaml", "camchain*.yaml", "stereo.y*ml", "SN*.conf")
"""What a rig file beside a recording may be called."""


def rig_beside(folder: Path, size_px: tuple[int, int]) -> StereoRig:
    """Read the rig file in a folder.

    `rig.yaml` wins; else there must be one of: a `left.yaml` + `right.yaml` pair, a Kalibr camchain, a `stereo.yaml`,
    a ZED `SN*.conf`.

    Parameters
    ----------
    folder
        Where to look.
    size_px
        Size of one camera's image, for formats that do not know it.

    Raises
    ------
    SourceError
        If there is none, or several.
    RigError, ValueRefusedError
        If it cannot be trusted.
    """
    if (own := folder / "rig.yaml").is_file():
        return read_rig(own)
    found = sorted(path for pattern in RIG_FILES for path in folder.glob(pattern) if path.is_file())
    if not found:
        raise SourceError(
            f"{folder} holds no rig file ({', '.join(RIG_FILES)}): say how the cameras stand with --rig FILE"
        )
    if len(found) > 1:
        raise SourceError(
            f"{folder} holds several rig files ({', '.join(path.name for path in found)}): choose with --rig FILE"
        )
    right = folder / "right.yaml" if found[0].name == "left.yaml" else None
    return read_rig(found[0], right=right, size_px=size_px)
