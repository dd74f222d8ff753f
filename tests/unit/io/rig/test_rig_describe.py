"""A rig in words, against hand formulas."""

import math
import re
from dataclasses import replace

import numpy as np
import pytest
from rig_examples import crooked_rig, pose

from roadblock.io.rig import describe_rig
from roadblock.values.camera import Camera, RigCovariance, StereoRig, rig_parameters


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
    assert rows["range error from calibration"] == "unknown: the file holds no covariance"


def test_crooked_rig():
    rows = dict(
        describe_rig(crooked_rig("brown_conrady", "kannala_brandt", mounting=True, rotvec=np.radians([1, -2, 2])))
    )
    assert rows["rotation between the cameras"] == "3.000 deg (about x 1.000, y -2.000, z 2.000)"
    assert rows["images"] == "raw: will be rectified"
    assert rows["mounting"] == "1.200 m forward, -0.100 m left, 1.400 m up in the vehicle frame"
    assert rows["left lens"].startswith("brown-conrady (-0.27, 0.11,")
    assert rows["right lens"].startswith("kannala-brandt (")


@pytest.mark.parametrize(("verdict", "word"), [("good", "good"), ("usable", "usable"), ("refused", "REFUSED")])
def test_what_the_calibration_said_of_itself(verdict, word):
    assert dict(describe_rig(replace(crooked_rig("pinhole", "pinhole"), verdict=verdict)))["calibration"].startswith(
        word
    )


def vergence_known_to(sigma_deg, baseline_m=0.25):
    camera = Camera((640, 480), 320, 320, 319.5, 239.5)
    names = rig_parameters(camera, camera)
    variances = np.where(np.array(names) == "ry_rad", math.radians(sigma_deg) ** 2, 0.0)
    return StereoRig(
        camera, camera, pose((0, 0, 0), (baseline_m, 0, 0)), covariance=RigCovariance(names, np.diag(variances))
    )


def test_range_error_from_calibration():
    """A turn r of the right camera is Z^2 / B (1 + tan^2) r; the outermost areas' centres lie at tan = 6/7 left."""
    rows = dict(describe_rig(vergence_known_to(0.01)))
    middle = 20**2 / 0.25 * math.radians(0.01)
    rms, worst = re.fullmatch(
        r"(\S+) m \(1 sigma; worst corner (\S+) m\)", rows["range error from calibration at 20 m"]
    ).groups()
    assert float(worst) == pytest.approx(middle * (1 + (6 / 7 + 0.25 / 20) ** 2), rel=0.05)
    assert middle < float(rms) < float(worst)
    assert [f"range error from calibration at {z} m" in rows for z in (5, 10, 20, 40)] == [True] * 4
    assert "range error from calibration" not in rows


def test_range_error_where_the_cameras_share_no_view():
    rows = dict(describe_rig(vergence_known_to(0.01, 2.9)))
    assert rows["range error from calibration at 5 m"].endswith(" m)")
    camera = Camera((640, 480), 3200, 3200, 319.5, 239.5)  # 11 degrees of view, turned by 15
    away = StereoRig(
        camera,
        camera,
        pose((0, math.radians(15), 0), (0.25, 0, 0)),
        covariance=vergence_known_to(0.01).covariance,
    )
    rows = dict(describe_rig(away))
    assert rows["range error from calibration at 5 m"] == "unknown: not both cameras see that far"


def test_fisheye_sees_more_than_half_the_world():
    """An equidistant lens has angle = radius / f: 0.5 px beyond each border pixel's centre."""
    camera = Camera((701, 101), 200, 200, 350, 50, "kannala_brandt", [0, 0, 0, 0])
    rows = dict(describe_rig(StereoRig(camera, camera, pose((0, 0, 0), (0.2, 0, 0)))))
    assert rows["left field of view"].startswith(f"{math.degrees(701 / 200):.1f} deg horizontal")


def test_lens_that_folds_inside_the_image():
    camera = Camera((640, 480), 100, 100, 320, 240, "brown_conrady", [-0.3, 0, 0, 0, 0])
    rows = dict(describe_rig(StereoRig(camera, camera, pose((0, 0, 0), (0.2, 0, 0)))))
    assert "unknown (the lens model ends inside the image) horizontal" in rows["left field of view"]
