"""`roadblock rig check`, on a short rendered drive."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from synthetic import paper_rig_of_width

from roadblock.cli import rigcheck
from roadblock.geometry.uncertainty import moved_rig
from roadblock.io.rig import read_rig, write_rig
from roadblock.io.sources import open_source
from roadblock.io.sources.source import ImagePairs
from roadblock.sim.drive import DriveSettings, simulate
from roadblock.sim.scenes import SCENES
from roadblock.values.camera import StereoRig

YAW_DEG = 0.08


def yawed(rig: StereoRig, yaw_deg: float) -> StereoRig:
    return moved_rig(rig, [0] * 9 + [np.radians(yaw_deg), 0, 0, 0, 0])


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Fourteen pairs of 480x270 through the city; beside the true rig one whose right camera is turned."""
    out = tmp_path_factory.mktemp("drive") / "drive"
    rig = paper_rig_of_width(480)
    list(simulate(SCENES["city"](0), rig, DriveSettings(frames=14), out))
    write_rig(rig, out / "rig.yaml")
    write_rig(yawed(rig, -YAW_DEG), out.parent / "old.yaml")
    return out


def test_a_healthy_drive(roadblock, drive: Path, work: Path) -> None:
    ran = roadblock("rig", "check", drive, "-o", "proposed.yaml")
    assert ran.code == 0
    assert "\nok: the cameras stand as the rig says" in ran.out
    assert ran.err == "note: nothing to propose: the rig is ok; proposed.yaml was not written\n"
    assert list(work.iterdir()) == []


def test_a_moved_rig_is_found_and_its_successor_proposed(roadblock, drive: Path, work: Path) -> None:
    old = drive.parent / "old.yaml"
    before = old.read_bytes()
    ran = roadblock("rig", "check", drive, "--rig", old, "-o", "proposed.yaml")
    assert (ran.code, ran.err) == (0, "")
    assert "moved: the right camera looks 0.0" in ran.out
    assert "further to the right than the rig says: disparities are +0." in ran.out
    assert "(from frame 0000" in ran.out
    assert "\nwrote proposed.yaml: rows change by " in ran.out
    assert "\ndisparities change by -0.5" in ran.out
    assert "what it shows at 20 m, the rig in use shows at 17." in ran.out
    assert old.read_bytes() == before
    turned = read_rig("proposed.yaml").T_left_right[:3, :3]
    assert np.degrees(np.arccos((np.trace(turned) - 1) / 2)) < 0.2 * YAW_DEG  # the true cameras are parallel
    assert "\nok: " in roadblock("rig", "check", drive, "--rig", "proposed.yaml").out


def test_without_asking_nothing_is_written(roadblock, drive: Path, work: Path) -> None:
    ran = roadblock("rig", "check", drive, "--rig", drive.parent / "old.yaml", "--frames", 10)
    assert (ran.code, ran.err) == (0, "")
    assert "10 frames, " in ran.out
    assert "wrote" not in ran.out
    assert list(work.iterdir()) == []


def test_only_what_is_known_is_proposed(roadblock, drive: Path, work: Path) -> None:
    """Single frames tell pitch and roll, but no yaw."""
    rig = paper_rig_of_width(480)
    write_rig(moved_rig(rig, [0] * 8 + [np.radians(0.1), 0, 0, 0, 0, 0]), Path("old.yaml"))
    pairs = [f"{drive}/left/{i:06d}.png {drive}/right/{i:06d}.png" for i in range(8)]
    Path("pairs.txt").write_text("\n".join(pairs) + "\n")
    ran = roadblock("rig", "check", "pairs.txt", "--rig", "old.yaml", "-o", "proposed.yaml")
    assert ran.code == 0
    assert " yaw: disparities                       unknown       unknown" in ran.out
    assert "wrote proposed.yaml: rows change by +0.6" in ran.out
    assert "further down than the rig says" in ran.out
    assert "shows at" not in ran.out
    proposed = read_rig("proposed.yaml").T_left_right[:3, :3]
    assert np.degrees(np.arccos((np.trace(proposed) - 1) / 2)) < 0.03


def test_several_rigs_are_refused(roadblock, data_dir: Path, work: Path) -> None:
    ran = roadblock("rig", "check", data_dir / "kitti_road")
    assert ran.code == 2
    assert "holds frames of several rigs, but one rig is checked at a time: name it with --rig" in ran.err


def test_what_the_recording_passed_over_is_told(
    roadblock, drive: Path, work: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    source = open_source(drive)
    assert isinstance(source, ImagePairs)
    short = replace(source, frames=source.frames[:1], warnings=["left/9.png has no partner"])
    monkeypatch.setattr(rigcheck, "open_source", lambda *_, **__: short)
    ran = roadblock("rig", "check", drive)
    assert (ran.code, ran.err) == (0, "note: left/9.png has no partner\n")
    assert "unknown: the yaw shows only while driving: 0 of 3 stretches seen" in ran.out


def test_a_recording_without_a_pair(roadblock, drive: Path, work: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    source = open_source(drive)
    assert isinstance(source, ImagePairs)
    monkeypatch.setattr(rigcheck, "open_source", lambda *_, **__: replace(source, frames=()))
    ran = roadblock("rig", "check", drive)
    assert (ran.code, ran.out) == (2, "")
    assert ran.err == "error: drive holds no pair that can be read: nothing to check the rig with\n"


def test_the_published_calibration_of_kitti(roadblock, data_dir: Path, work: Path) -> None:
    """Its yaw holds within the check's own sigma; its rows are half a pixel off, and its lenses do not fit."""
    ran = roadblock("rig", "check", data_dir / "kitti_raw_0926")
    (yaw,) = (line for line in ran.out.splitlines() if "yaw: disparities" in line)
    px, _, sigma = yaw.split()[-3:]
    assert abs(float(px)) < 2 * float(sigma) < 0.3
    assert "which image expansion rules out: the lens calibration is off" in ran.out
