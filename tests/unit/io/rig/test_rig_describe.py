"""A rig in words, against hand formulas."""

import math

import numpy as np
from rig_examples import crooked_rig, pose

from roadblock.io.rig import describe_rig
from roadblock.values.camera import Camera, StereoRig


def test_rectified_rig():
    camera = Camera((640, 480), 320, 320, 319.5, 239.5)
    rows = dict(describe_rig(StereoRig(camera, camera, pose((0, 0, 0), (0.25, 0, 0)))))
    vertical = 2 * math.degrees(math.atan(240 / 320))
    assert rows["image size"] == "640 x 480 px"
    assert rows["left field of view"] == f"90.0 deg horizontal, {vertical:.1f} deg vertical"
    assert rows["left lens"] == "pinhole"
    assert rows["baseline"] == "0.25 m"
    assert rows["rotation between the cameras"].startswith("0.000 deg")
    assert rows["range step per 0.1 px at 20 m"] == "0.5 m"  # 400 / (320 * 0.25) * 0.1
    assert rows["range step per 0.1 px at 40 m"] == "2 m"
    assert rows["images"] == "already rectified"
    assert rows["mounting"].startswith("unknown")


def test_crooked_rig():
    rows = dict(
        describe_rig(crooked_rig("brown_conrady", "kannala_brandt", mounting=True, rotvec=np.radians([1, -2, 2])))
    )
    assert rows["rotation between the cameras"] == "3.000 deg (about x 1.000, y -2.000, z 2.000)"
    assert rows["images"] == "raw: will be rectified"
    assert rows["mounting"] == "1.200 m forward, -0.100 m left, 1.400 m up in the vehicle frame"
    assert rows["left lens"].startswith("brown-conrady (-0.27, 0.11,")
    assert rows["right lens"].startswith("kannala-brandt (")


def test_fisheye_sees_more_than_half_the_world():
    """An equidistant lens has angle = radius / f: 0.5 px beyond each border pixel's centre."""
    camera = Camera((701, 101), 200, 200, 350, 50, "kannala_brandt", [0, 0, 0, 0])
    rows = dict(describe_rig(StereoRig(camera, camera, pose((0, 0, 0), (0.2, 0, 0)))))
    assert rows["left field of view"].startswith(f"{math.degrees(701 / 200):.1f} deg horizontal")


def test_lens_that_folds_inside_the_image():
    camera = Camera((640, 480), 100, 100, 320, 240, "brown_conrady", [-0.3, 0, 0, 0, 0])
    rows = dict(describe_rig(StereoRig(camera, camera, pose((0, 0, 0), (0.2, 0, 0)))))
    assert "unknown (the lens model ends inside the image) horizontal" in rows["left field of view"]
