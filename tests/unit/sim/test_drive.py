import json

import numpy as np
import pytest

from roadblock.geometry.pose import pose
from roadblock.sim.drive import truth_record
from roadblock.sim.render import render
from roadblock.sim.scene import Road, Scene, camera_pose
from roadblock.sim.solids import placed
from roadblock.sim.things import crate
from roadblock.values.camera import Camera, StereoRig

CAMERA = Camera((97, 61), 80.0, 80.0, 51.3, 27.6)
RIG = StereoRig(CAMERA, CAMERA, pose(np.eye(3), [0.3, 0, 0]))


def record_of(*things):
    scene = Scene(things, Road(), camera_pose(1.3, 0.05))
    return truth_record(render(scene, RIG, samples=1, index=3, name="000003", t_ns=17))


def test_record_is_plain_json_with_the_documented_keys():
    record = record_of(placed(crate(7, "red", (200, 30, 30), (0.5, 1.0, 0.8)), 5.0, 0.3))
    assert json.loads(json.dumps(record, allow_nan=False)) == record
    assert list(record) == ["schema", "frame", "name", "t_ns", "objects", "ground"]
    assert (record["schema"], record["frame"], record["name"], record["t_ns"]) == (1, 3, "000003", 17)
    (true,) = record["objects"]
    keys = "id type color position_m range_m mean_range_m size_m box_px visible_px"
    assert list(true) == keys.split()
    assert (true["id"], true["type"], true["color"], true["size_m"]) == (7, "box", "red", [1.0, 0.8, 0.5])
    assert record["ground"] == pytest.approx({"height_m": 1.3, "pitch_rad": 0.05, "roll_rad": 0.0})


def test_a_level_road_has_no_minus_zero():
    record = truth_record(render(Scene((), Road(), camera_pose()), RIG, samples=1))
    assert "-0" not in json.dumps(record["ground"])


def test_a_nameless_colour_is_null_and_an_empty_street_has_no_objects():
    (true,) = record_of(placed(crate(1, "", (200, 30, 30), (0.5, 1.0, 0.8)), 5.0, 0.3))["objects"]
    assert true["color"] is None
    assert record_of()["objects"] == []
