import json
import math
import signal
import subprocess
import sys
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest

from roadblock.errors import OutputError, SourceError
from roadblock.io.results import (
    JsonlSink,
    frame_record,
    prepare_folder,
    read_results,
    run_record,
    write_run,
)
from roadblock.io.schema import FrameRecord
from roadblock.values.decision import Decision
from roadblock.values.motion import Track
from roadblock.values.scene import FrameResult, FreeSpace, GroundPlane, Health, Obstacle, RoadEdges, Stixels

NAN = math.nan


def make_obstacle(**changes) -> Obstacle:
    fields = {
        "position_m": np.array([12.34567, -0.5, -1.2]),
        "range_m": 12.345678,
        "range_sigma_m": 0.2,
        "size_m": np.array([1.80004, 1.5, NAN]),
        "uvd_px": np.array([40.0, 30.0, 3.0]),
        "cov_uvd_px2": np.eye(3),
        "cov_match_m2": np.eye(3),
        "box_px": (np.int64(10), np.int64(11), np.int64(30), np.int64(42)),
        "contour_px": np.array([[10, 11], [29, 11], [29, 41]], np.int32),
        "color": "red",
    }
    return Obstacle(**(fields | changes))


def make_result(index: int = 0, **changes) -> FrameResult:
    fields = {
        "index": index,
        "name": f"{index:06d}",
        "t_ns": 1_317_000_000_123_456_789 + index,
        "obstacles": (make_obstacle(),),
        "free_space": FreeSpace(np.array([3.5, 11.5, 19.5]), np.array([7.25, NAN, np.inf])),
        "ground": GroundPlane(np.array([0.0, -math.cos(0.02), -math.sin(0.02)]), 1.654321),
        "health": Health("degraded", ("too dark",)),
        "timings_ms": {"match": 12.34567, "total": 20.0},
    }
    return FrameResult(**(fields | changes))


def test_record_is_the_public_schema():
    # Written out by hand from the schema: every key, unknown = None, metres to 4 decimals, px to 2, rad to 6, ms to 3.
    assert frame_record(make_result()) == {
        "schema": 1,
        "frame": 0,
        "name": "000000",
        "t_ns": 1_317_000_000_123_456_789,
        "obstacles": [
            {
                "id": None,
                "class": "unknown",
                "class_probability": None,
                "class_odds": {},
                "color": "red",
                "colors": [],
                "color_lab": None,
                "position_m": [12.3457, -0.5, -1.2],
                "range_m": 12.3457,
                "range_sigma_m": 0.2,
                "range_sigma_calib_m": None,
                "cov_calib_m2": None,
                "size_m": [1.8, 1.5, None],
                "size_sigma_m": [None, None, None],
                "outline_m": [],
                "heading_rad": None,
                "heading_sigma_rad": None,
                "box_px": [10, 11, 30, 42],
                "seen_through": False,
                "contour_px": [[10, 11], [29, 11], [29, 41]],
                "velocity_mps": None,
                "ttc_s": None,
            }
        ],
        "free_space": {"u_px": [3.5, 11.5, 19.5], "range_m": [7.25, None, None], "blocked": None, "edges": None},
        "ground": {"height_m": 1.6543, "pitch_rad": 0.02, "roll_rad": 0.0},
        "health": {"state": "degraded", "reasons": ["too dark"]},
        "timings_ms": {"match": 12.346, "total": 20.0},
        "stixels": None,
        "decision": None,
    }


def test_a_decision_is_told_with_its_reason():
    record = frame_record(make_result(decision=Decision("brake", "a wall", 1.23456, NAN, 4.0, obstacle_id=7)))
    assert FrameRecord.model_validate(record).decision is not None
    assert record["decision"] == {
        "action": "brake",
        "reason": "a wall",
        "ttc_s": 1.2346,
        "ttc_sigma_s": None,
        "deceleration_mps2": 4.0,
        "curvature_per_m": 0.0,
        "offset_m": 0.0,
        "obstacle_id": 7,
    }


def test_record_holds_edges_and_stixels():
    edges = RoadEdges(np.array([5.0, NAN]), np.array([0.123456, NAN]), np.array([2, 0], np.uint8))
    free = FreeSpace(np.array([1.5, 5.5]), np.array([7.25, 8.0]), np.array([True, False]), edges)
    stixels = Stixels(*np.array([[1.5], [10], [20], [7.25]]), np.array([NAN]))
    record = frame_record(make_result(free_space=free, stixels=stixels))
    FrameRecord.model_validate(record)
    assert record["free_space"]["blocked"] == [True, False]
    assert record["free_space"]["edges"] == {
        "range_m": [5.0, None],
        "height_m": [0.1235, None],
        "kind": ["verge", None],
    }
    assert record["stixels"] == {
        "u_px": [1.5],
        "top_px": [10.0],
        "bottom_px": [20.0],
        "range_m": [7.25],
        "height_m": [None],
    }


def test_record_of_a_recognised_obstacle():
    known = make_obstacle().recognized(
        label="car",
        probability=0.91237,
        class_odds={"car": 0.91237, "wall": 0.08, "pole": 0.004},
        colors=("red", "white"),
        color_lab=np.array([41.93, 58.33, 41.22]),
        size_sigma_m=np.array([0.05, 0.04, NAN]),
        outline_m=np.array([[12.3, -0.2], [12.3, -1.9], [12.51234, -1.9]]),
        heading_rad=0.1,
        heading_sigma_rad=0.02,
    )
    record = frame_record(make_result(obstacles=(known,)))
    FrameRecord.model_validate(record)
    obstacle = record["obstacles"][0]
    assert (obstacle["class"], obstacle["class_probability"]) == ("car", 0.9124)
    assert obstacle["class_odds"] == {"car": 0.9124, "wall": 0.08}
    assert (obstacle["colors"], obstacle["color_lab"]) == (["red", "white"], [41.9, 58.3, 41.2])
    assert obstacle["size_sigma_m"] == [0.05, 0.04, None]
    assert obstacle["outline_m"][2] == [12.5123, -1.9]
    assert (obstacle["heading_rad"], obstacle["heading_sigma_rad"]) == (0.1, 0.02)


def test_record_of_nothing_known_is_plain_json():
    obstacle = make_obstacle(
        range_sigma_m=np.inf, size_m=np.full(3, NAN), color=None, contour_px=np.zeros((0, 2), np.int32)
    )
    result = make_result(obstacles=(obstacle,), ground=None, timings_ms={"total": NAN}, name="\udcff.png")
    record = frame_record(result)
    json.dumps(record, allow_nan=False)
    FrameRecord.model_validate(record)
    assert record["ground"] is None
    assert record["obstacles"][0]["range_sigma_m"] is None
    assert record["obstacles"][0]["contour_px"] == []
    assert record["timings_ms"] == {"total": None}
    assert record["name"] == "?.png"


def test_record_holds_what_the_calibration_does():
    direction = np.array([12.3, -0.5, -1.2])
    cov = 1e-7 * np.outer(direction, direction) + 1e-12 * np.eye(3)  # almost along the line of sight alone
    told = make_obstacle(cov_calib_m2=cov, range_sigma_calib_m=0.0123456)
    record = frame_record(make_result(obstacles=(told,)))["obstacles"][0]
    assert record["range_sigma_calib_m"] == 0.0123
    read = np.array(json.loads(json.dumps(record))["cov_calib_m2"])
    np.testing.assert_allclose(read, cov, rtol=1e-8)
    assert np.linalg.eigvalsh(read).min() > 0.9e-12  # still a covariance
    half = make_obstacle(cov_calib_m2=np.diag([1.0, np.nan, 1.0]))
    assert frame_record(make_result(obstacles=(half,)))["obstacles"][0]["cov_calib_m2"] is None


@pytest.mark.parametrize("missing", ["range_sigma_calib_m", "cov_calib_m2"])
def test_records_from_before_the_calibration_s_error_read(tmp_path, missing):
    record = frame_record(make_result())
    del record["obstacles"][0][missing]
    path = tmp_path / "obstacles.jsonl"
    path.write_text(json.dumps(record) + "\n")
    assert read_results(path) == [record]


def test_record_holds_a_class_and_no_minus_zero():
    obstacle = make_obstacle(label="car", probability=0.87654, position_m=np.array([5.0, -0.0, -1e-9]))
    record = frame_record(make_result(obstacles=(obstacle,)))["obstacles"][0]
    assert (record["class"], record["class_probability"]) == ("car", 0.8765)
    assert str(record["position_m"]) == "[5.0, 0.0, 0.0]"


def test_documented_example_is_valid():
    page = (Path(__file__).parents[3] / "docs/results.md").read_text(encoding="utf-8")
    example = page.partition("```json\n")[2].partition("```")[0]
    FrameRecord.model_validate(json.loads(example))


def test_sink_writes_lines_that_read_back(tmp_path):
    path = tmp_path / "new" / "obstacles.jsonl"
    results = [make_result(i) for i in range(3)]
    with JsonlSink(path) as sink:
        for count, result in enumerate(results, start=1):
            sink.write(result)
            assert path.read_bytes().count(b"\n") == count  # on the disk before the next frame
    assert read_results(path) == [frame_record(result) for result in results]


def test_sink_replaces_an_older_file(tmp_path):
    path = tmp_path / "obstacles.jsonl"
    path.write_text("old\n" * 100)
    with JsonlSink(path) as sink:
        sink.write(make_result())
    assert len(read_results(path)) == 1


def test_no_frames_is_an_empty_list(tmp_path):
    with JsonlSink(tmp_path / "obstacles.jsonl"):
        pass
    assert read_results(tmp_path / "obstacles.jsonl") == []


def test_sink_never_entered_closes_quietly(tmp_path):
    JsonlSink(tmp_path / "x.jsonl").__exit__(None, None, None)
    assert not (tmp_path / "x.jsonl").exists()


def run_python(code: str, *arguments: str) -> subprocess.Popen:
    here = str(Path(__file__).parent)
    command = [sys.executable, "-c", f"import sys; sys.path.insert(0, {here!r})\n{code}", *arguments]
    return subprocess.Popen(command, stdout=subprocess.PIPE, text=True)


ENDLESS = """
import sys
from pathlib import Path
from roadblock.io.results import JsonlSink
from test_results import make_result
results = [make_result(i) for i in range(20)]
with JsonlSink(Path(sys.argv[1])) as sink:
    while True:
        for result in results:
            sink.write(result)
        print(flush=True)
"""


@pytest.mark.parametrize("blow", [signal.SIGKILL, signal.SIGINT])
def test_interruption_leaves_whole_lines(tmp_path, blow):
    path = tmp_path / "obstacles.jsonl"
    process = run_python(ENDLESS, str(path))
    with process:
        process.stdout.readline()
        process.send_signal(blow)
        process.communicate(timeout=20)
    assert process.returncode != 0
    assert len(read_results(path)) >= 20


FULL_DISK = """
import resource, sys
from pathlib import Path
from roadblock.errors import OutputError
from roadblock.io.results import JsonlSink
from test_results import make_result
resource.setrlimit(resource.RLIMIT_FSIZE, (2500, 2500))
with JsonlSink(Path(sys.argv[1])) as sink:
    try:
        for i in range(100):
            sink.write(make_result(i))
    except OutputError as error:
        print(error)
"""


@pytest.mark.skipif(sys.platform == "win32", reason="no file size limit to set")
def test_full_disk_is_told_and_leaves_whole_lines(tmp_path):
    path = tmp_path / "obstacles.jsonl"
    output, _ = run_python(FULL_DISK, str(path)).communicate(timeout=20)
    assert output.startswith(f"cannot write {path}: ")
    lines = read_results(path)
    size = path.stat().st_size
    assert len(lines) > 1
    assert size + size // len(lines) > 2500  # one more would not have fitted


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no device that is always full")
def test_full_device_is_told():
    with JsonlSink(Path("/dev/full")) as sink, pytest.raises(OutputError, match="cannot write /dev/full: No space"):
        sink.write(make_result())


def test_unwritable_folder_is_refused(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match=r"cannot write .*choose another folder"):
        JsonlSink(tmp_path / "file" / "obstacles.jsonl").__enter__()


LINE = json.dumps(frame_record(make_result()))


def with_change(**changes) -> str:
    return json.dumps(json.loads(LINE) | changes)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        (LINE + "\n" + LINE[:-20], r"last line \(2\) is cut off"),
        (LINE, "cut off"),  # without its end of line it was not finished
        (LINE[:-5] + "\n" + LINE + "\n", "line 1: no JSON object"),
        ("\n", "line 1: no JSON"),
        ("\x00\x01\x02\n", "line 1: no JSON"),
        (LINE.replace("12.3457", "NaN") + "\n", "no JSON"),
        ("[" * 100_000 + "\n", "no JSON"),
        ("17\n", "expected one JSON object per line, but got '17'"),
        ("{}\n", "schema is None, but this version of roadblock reads 1"),
        (with_change(schema=2) + "\n", "schema is 2"),
        (with_change(frame="0") + "\n", "field frame"),
        (with_change(frame=True) + "\n", "field frame"),
        (with_change(obstacles=[{}]) + "\n", r"field obstacles\.0\.id: Field required"),
        (LINE.replace("[10, 11, 30, 42]", "[10, 11, 30]") + "\n", r"obstacles\.0\.box_px"),
        (LINE.replace("[10, 11, 30, 42]", "[10, 11, 30, 42.5]") + "\n", r"box_px\.3"),
    ],
)
def test_broken_files_are_told_in_one_line(tmp_path, text, told):
    path = tmp_path / "obstacles.jsonl"
    path.write_text(text)
    with pytest.raises(SourceError, match=told) as caught:
        read_results(path)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 400


def test_missing_file_and_invalid_utf8_are_told(tmp_path):
    with pytest.raises(SourceError, match="cannot read results"):
        read_results(tmp_path / "none.jsonl")
    (tmp_path / "bad.jsonl").write_bytes(b'{"schema":1,"name":"\xff"}\n')
    with pytest.raises(SourceError, match="no JSON"):
        read_results(tmp_path / "bad.jsonl")


def test_later_fields_are_let_through(tmp_path):
    path = tmp_path / "obstacles.jsonl"
    path.write_text(with_change(extra=1) + "\n")
    assert read_results(path)[0]["extra"] == 1


def leave_a_run(folder: Path) -> None:
    (folder / "overlay").mkdir(parents=True)
    for name in ("obstacles.jsonl", "run.json", "overlay.mp4", "overlay/000001.png", "overlay/000002.png"):
        (folder / name).write_text("old")


def test_prepare_makes_a_new_folder(tmp_path):
    assert prepare_folder(tmp_path / "a" / "b").is_dir()


def test_prepare_clears_an_earlier_run_and_nothing_else(tmp_path):
    leave_a_run(tmp_path)
    (tmp_path / "notes.txt").write_text("mine")
    (tmp_path / "overlay" / "mine.txt").write_text("mine")
    prepare_folder(tmp_path)
    left = sorted(str(path.relative_to(tmp_path)) for path in tmp_path.rglob("*") if path.is_file())
    assert left == ["notes.txt", str(Path("overlay/mine.txt"))]


def test_prepare_removes_an_empty_overlay_folder(tmp_path):
    leave_a_run(tmp_path)
    prepare_folder(tmp_path)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", ["run.json", "overlay.mp4", "overlay/holiday.png"])
def test_prepare_refuses_what_no_run_left(tmp_path, name):
    (tmp_path / name).parent.mkdir(exist_ok=True)
    (tmp_path / name).write_text("mine")
    with pytest.raises(OutputError, match=r"holds .* of something else than a run"):
        prepare_folder(tmp_path)
    assert (tmp_path / name).read_text() == "mine"


def test_prepare_follows_no_link_out_of_the_folder(tmp_path):
    (tmp_path / "photos").mkdir()
    (tmp_path / "photos" / "1.png").write_text("mine")
    run = tmp_path / "run"
    run.mkdir()
    (run / "obstacles.jsonl").write_text("")
    (run / "overlay").symlink_to(tmp_path / "photos")
    with pytest.raises(OutputError, match="holds overlay"):
        prepare_folder(run)
    assert (tmp_path / "photos" / "1.png").exists()


def test_prepare_tells_what_it_cannot_do(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="cannot write"):
        prepare_folder(tmp_path / "file")


def make_run(**changes) -> dict:
    fields = {
        "source": {"name": "street", "kind": "folder", "path": "/data/street", "frames": 26},
        "settings": {"match": {"method": "sgbm"}},
        "rig": {"baseline_m": 0.2},
        "started": datetime(2026, 1, 2, 3, 4, 5, tzinfo=UTC),
        "frames": 7,
        "interrupted": True,
    }
    return run_record(**(fields | changes))


def test_run_record_says_what_made_the_results(tmp_path):
    record = make_run()
    write_run(tmp_path / "new" / "run.json", record)
    back = json.loads((tmp_path / "new" / "run.json").read_text())
    assert back == record
    assert back["started"] == "2026-01-02T03:04:05.000+00:00"
    assert (back["frames_written"], back["interrupted"]) == (7, True)
    assert set(back["machine"]) == {"platform", "python", "cpu", "cores", "opencv", "numpy", "numba"}
    assert datetime.fromisoformat(back["finished"]).tzinfo == UTC
    assert back["version"]
    assert [path.name for path in (tmp_path / "new").iterdir()] == ["run.json"]


@pytest.mark.parametrize("bad", [{"x": NAN}, {"x": Path("a")}])
def test_run_that_json_cannot_hold_is_refused_and_the_old_one_stays(tmp_path, bad):
    (tmp_path / "run.json").write_text("old")
    with pytest.raises(OutputError, match=r"run\.json cannot hold"):
        write_run(tmp_path / "run.json", make_run(settings=bad))
    assert (tmp_path / "run.json").read_text() == "old"


def test_run_that_cannot_be_written_is_told_and_leaves_no_litter(tmp_path):
    (tmp_path / "run.json").mkdir()
    with pytest.raises(OutputError, match="cannot write"):
        write_run(tmp_path / "run.json", make_run())
    assert [path.name for path in tmp_path.iterdir()] == ["run.json"]


def make_track(**changes) -> Track:
    fields = {
        "id": 7,
        "age_s": 1.23456,
        "coasted_s": 0.1,
        "position_m": np.array([12.3, -0.5, 0.7]),
        "position_cov_m2": np.eye(3),
        "velocity_mps": np.array([-1.23456, 0.5]),
        "velocity_cov_m2ps2": np.diag([0.04, 0.01]),
        "is_over_ground": True,
        "motion": "moving",
        "ttc_s": 2.5,
        "ttc_sigma_s": 0.123456,
    }
    return Track(**(fields | changes))


def test_record_of_a_track():
    result = make_result(obstacles=(make_obstacle().with_track(make_track()), make_obstacle()))
    record = frame_record(result)
    FrameRecord.model_validate(record)
    tracked, plain = record["obstacles"]
    added = {key: value for key, value in tracked.items() if plain.get(key) != value}
    assert added == {
        "id": 7,
        "velocity_mps": [-1.2346, 0.5, 0.0],
        "velocity_sigma_mps": [0.2, 0.1],
        "velocity_over_ground": True,
        "motion": "moving",
        "ttc_s": 2.5,
        "ttc_sigma_s": 0.1235,
        "age_s": 1.2346,
        "coasted_s": 0.1,
    }
    away = make_obstacle().with_track(make_track(ttc_s=NAN, ttc_sigma_s=NAN))
    record = frame_record(make_result(obstacles=(away,)))
    FrameRecord.model_validate(record)
    assert record["obstacles"][0]["ttc_s"] is None
