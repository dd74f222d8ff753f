"""Kinds of bad input, and how each is made; what the user is told of each stands in `docs/bad-input.md`."""

import re
import shutil
import struct
import zlib
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np

Spoil = Callable[[], object]
"""Makes the input bad. It works in a folder with a sound `recording` of three frames of 160x90, to be changed at will,
and, to be left alone, another one, `street`, of 480x270, and `boards`, 14 pictures of a 7x5 chessboard of 25 mm from
each camera, 320x240."""


class Bad(NamedTuple):
    """One kind of bad input."""

    what: str
    """In words, for the page."""
    spoil: Spoil = lambda: None
    command: str = "detect recording --out results"
    whole_lines: int = 0
    """How many frames are found, and stay, before the bad input is met."""


LEFT, RIGHT, RIG = Path("recording/left"), Path("recording/right"), Path("recording/rig.yaml")
FIRST, SECOND = LEFT / "000000.png", LEFT / "000001.png"
WITH_RIG = "detect recording --rig other --out results"
GRAY = np.full((90, 160), 99, np.uint8)


def put(path: str | Path, content: str | bytes) -> Spoil:
    def spoil() -> None:
        Path(path).parent.mkdir(parents=True, exist_ok=True)
        Path(path).write_bytes(content.encode() if isinstance(content, str) else content)

    return spoil


def edit(path: str | Path, old: str, new: str) -> Spoil:
    """Replace the first match of a pattern; it must be there."""

    def spoil() -> None:
        text, count = re.subn(old, new, Path(path).read_text(), count=1)
        assert count == 1
        Path(path).write_text(text)

    return spoil


def cut(path: str | Path, share: float = 0.5) -> Spoil:
    def spoil() -> None:
        data = Path(path).read_bytes()
        Path(path).write_bytes(data[: int(share * len(data))])

    return spoil


def draw(path: str | Path, image: np.ndarray) -> Spoil:
    return put(path, cv2.imencode(Path(path).suffix, image)[1].tobytes())


def copy(source: str | Path, target: str | Path) -> Spoil:
    def spoil() -> None:
        Path(target).parent.mkdir(parents=True, exist_ok=True)
        (shutil.copytree if Path(source).is_dir() else shutil.copy)(source, target)

    return spoil


def move(source: str | Path, target: str | Path) -> Spoil:
    return lambda: Path(source).rename(target)


def remove(path: str | Path) -> Spoil:
    return lambda: shutil.rmtree(path) if Path(path).is_dir() else Path(path).unlink()


def both(*spoils: Spoil) -> Spoil:
    return lambda: [spoil() for spoil in spoils]


def pose(rows: Sequence[Sequence[float]]) -> Spoil:
    """Give the rig another pose of the right camera."""
    text = "T_left_right:" + "".join(f"\n  - {list(row)}" for row in rows)
    return edit(RIG, r"T_left_right:(\n  - .*){4}", text)


def beside(x: float, y: float = 0.0, z: float = 0.0) -> Spoil:
    return pose([[1, 0, 0, x], [0, 1, 0, y], [0, 0, 1, z], [0, 0, 0, 1]])


def png_that_declares(width: int, height: int) -> bytes:
    def chunk(name: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))

    head = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", zlib.compress(b"\0" * 9)) + chunk(b"IEND", b"")


def break_inside(path: Path) -> Spoil:
    def spoil() -> None:
        data = bytearray(path.read_bytes())
        middle = data.index(b"IDAT") + 4
        data[middle : middle + 2000] = bytes(2000)
        path.write_bytes(data)

    return spoil


def film(path: str, width: int = 320, height: int = 90, start_s: int = 0) -> Spoil:
    """Write a video of five frames."""

    def spoil() -> None:
        import av

        Path(path).parent.mkdir(exist_ok=True)
        with av.open(path, "w") as container:
            stream = container.add_stream("mpeg4", rate=10, options={"qscale:v": "3"})
            stream.width, stream.height, stream.pix_fmt = width, height, "yuv420p"
            noise = np.random.default_rng(3).integers(0, 256, (height, width, 3), np.uint8)
            for index in range(5):
                frame = av.VideoFrame.from_ndarray(noise, format="rgb24")
                frame.pts = index + 10 * start_s
                container.mux(stream.encode(frame))
            container.mux(stream.encode())

    return spoil


def opencv_rig(width: str = "image_width: 160\nimage_height: 90\n", D1: str = "0., 0., 0., 0., 0.") -> str:
    def matrix(name: str, rows: int, data: str) -> str:
        cols = len(data.split(",")) // rows
        return f"{name}: !!opencv-matrix\n   rows: {rows}\n   cols: {cols}\n   dt: d\n   data: [ {data} ]\n"

    K = "129., 0., 80., 0., 129., 45., 0., 0., 1."
    D = matrix("D1", 1, D1) + matrix("D2", 1, "0., 0., 0., 0., 0.")
    pose_ = matrix("R", 3, "1., 0., 0., 0., 1., 0., 0., 0., 1.") + matrix("T", 3, "-0.2, 0., 0.")
    return f"%YAML:1.0\n---\n{width}{matrix('M1', 3, K)}{matrix('M2', 3, K)}{D}{pose_}"


def shots(*names: str, left: str = "left", right: str = "right") -> Spoil:
    """Copy pictures of the board to `shots/left` and `shots/right`, all or those named; from other sides, if asked."""

    def spoil() -> None:
        for source, target in ((left, "left"), (right, "right")):
            Path("shots", target).mkdir(parents=True, exist_ok=True)
            for path in sorted(Path("boards", source).iterdir()):
                if not names or path.stem in names:
                    shutil.copy(path, Path("shots", target))

    return spoil


def each(folder: str, change: Callable[[np.ndarray], np.ndarray]) -> Spoil:
    """Change every picture of a folder."""

    def spoil() -> None:
        for path in Path(folder).iterdir():
            cv2.imwrite(str(path), change(cv2.imread(str(path), 0)))

    return spoil


def calibrate(pictures: str = "shots", board: str = "chessboard:7x5", length: str = "--square 25mm") -> str:
    return f"calibrate {pictures} --board {board} {length}"


def mirrored(image: np.ndarray) -> np.ndarray:
    return image[:, ::-1]


def noise(image: np.ndarray) -> np.ndarray:
    return np.random.default_rng(int(image.sum())).integers(80, 120, image.shape, np.uint8)


CAM = (
    "  camera_model: pinhole\n  intrinsics: [129, 129, 80, 45]\n  distortion_model: none\n  resolution: [160, 90]\n"
    "  T_cn_cnm1: [[1, 0, 0, -0.2], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]\n"
)
INFO = (
    "image_width: 160\nimage_height: 90\ncamera_matrix:\n  data: [0, 0, 0, 0, 0, 0, 0, 0, 0]\n"
    "distortion_model: plumb_bob\n"
)
BOMB = "roadblock_rig: 1\na: &a [x, x]\nb: &b [*a, *a, *a]\nc: &c [*b, *b, *b]\n"
FOUND = (
    '{"schema": 1, "frame": 0, "name": "000000", "t_ns": 0, "obstacles": [{"id": null, "class": "unknown", '
    '"class_probability": null, "color": null, "position_m": [5.0, 0.0, 0.0], "range_m": 5.0, "range_sigma_m": null, '
    '"size_m": [1.0, 1.0, null], "box_px": [10, 10, 20, 20], "contour_px": [], "velocity_mps": null, "ttc_s": null}], '
    '"free_space": {"u_px": [], "range_m": []}, "ground": null, "health": {"state": "ok", "reasons": []}, '
    '"timings_ms": {}}\n'
)
found = put("found/obstacles.jsonl", FOUND)
LABEL = "Car 0 0 0 1 1 9 9 1.5 1.6 4 0 1.6 9 0\n"
COLOR_RIG = "P2: 9 0 9 0 0 9 9 0 0 0 1 0\nP3: 9 0 9 -4 0 9 9 0 0 0 1 0\n"
AGAINST = "evaluate found --truth recording"
KITTI_RIG = "P0: 129 0 80 0 0 129 45 0 0 0 1 0\nP1: 129 0 80 -26 0 129 45 0 0 0 1 0\n"
as_kitti = both(move(LEFT, "recording/image_0"), move(RIGHT, "recording/image_1"), remove(RIG))

BAD: dict[str, tuple[Bad, ...]] = {
    "Recordings": (
        Bad("nothing is there", command="detect nowhere --out results"),
        Bad("an empty folder", lambda: Path("empty").mkdir(), "detect empty"),
        Bad("a folder of something else", put("photos/a.png", b""), "detect photos"),
        Bad("a file of something else", put("notes.pdf", b"%PDF"), "detect notes.pdf"),
        Bad("a misspelt `--kind`", command="detect recording --kind foldr"),
        Bad("another `--kind` than it is", command="detect recording --kind kitti-raw-gray"),
        Bad("two kinds at once", both(copy(LEFT, "recording/image_0"), copy(RIGHT, "recording/image_1"))),
        Bad("two pairs of folders", both(copy(LEFT, "recording/l"), copy(RIGHT, "recording/r"))),
        Bad("no images", both(remove(LEFT), put(LEFT / "readme.txt", "none"))),
        Bad("an image without partner", remove(RIGHT / "000001.png")),
        Bad("two images claim one frame", copy(FIRST, LEFT / "000000.bmp")),
        Bad("no rig", remove(RIG)),
        Bad("several rigs", both(move(RIG, "recording/stereo.yaml"), put("recording/SN12.conf", "[STEREO]"))),
        Bad("fewer time stamps than pairs", put("recording/timestamps.txt", "0.1\n0.2\n")),
        Bad("time stamps out of order", put("recording/timestamps.txt", "0.1\n0.3\n0.2\n")),
        Bad("seconds where nanoseconds belong", put("recording/timestamps.txt", "1\n2\n3\n")),
        Bad("a time stamp that is none", put("recording/timestamps.txt", "0.1\nnan\n0.3\n")),
        Bad("time stamps that are no text", put("recording/timestamps.txt", b"\xff\xfe\0\0")),
        Bad("KITTI images without calibration", as_kitti),
        Bad("a KITTI sequence without calibration", both(as_kitti, put("recording/times.txt", "0.0\n0.1\n0.2\n"))),
        Bad(
            "a KITTI drive without time stamps",
            both(*(copy(f"recording/{a}", f"recording/image_0{b}/data") for a, b in (("left", 0), ("right", 1)))),
            "detect recording --kind kitti-raw-gray",
        ),
    ),
    "Lists of pairs": (
        Bad("an empty list", put("pairs.txt", "# left right\n"), "detect pairs.txt"),
        Bad("a list that is no text", put("pairs.txt", b"\x89PNG\xff"), "detect pairs.txt"),
        Bad("a line with too many columns", put("pairs.txt", f"{FIRST} {FIRST} 1 2\n"), "detect pairs.txt"),
        Bad(
            "time stamps on some lines only",
            put("pairs.txt", f"{FIRST} {FIRST} 1\n{FIRST} {FIRST}\n"),
            "detect pairs.txt",
        ),
        Bad("a listed image is missing", put("pairs.csv", "a.png,b.png\n"), "detect pairs.csv"),
        Bad("a listed time stamp that is none", put("pairs.txt", f"{FIRST} {FIRST} 0.5\n"), "detect pairs.txt"),
        Bad(
            "listed time stamps that go back",
            put("pairs.txt", f"{FIRST} {FIRST} 900000\n{FIRST} {FIRST} 1\n"),
            "detect pairs.txt",
        ),
    ),
    "Images": (
        Bad("an empty image", put(FIRST, b"")),
        Bad("a text with an image's name", put(FIRST, "not an image")),
        Bad("an image cut short", cut(FIRST)),
        Bad(
            "a JPEG cut short",
            both(remove(FIRST), draw(FIRST.with_suffix(".jpg"), GRAY), cut(FIRST.with_suffix(".jpg"), 0.7)),
        ),
        Bad("an image broken inside", break_inside(FIRST)),
        Bad("an image of zero size", put(FIRST, png_that_declares(0, 90))),
        Bad("a small file that would unpack to 7 GB", put(FIRST, png_that_declares(60_000, 60_000))),
        Bad("floating-point pixels", both(remove(FIRST), draw(FIRST.with_suffix(".tiff"), np.float32(GRAY)))),
        Bad("images of another size than the rig", draw(FIRST, GRAY[:80])),
        Bad("one camera grey, one colour", draw(FIRST, GRAY)),
        Bad("one camera 8 bit, one 16 bit", both(draw(FIRST, GRAY), draw(RIGHT / "000000.png", np.uint16(GRAY)))),
        Bad("a broken image in the middle", cut(SECOND), whole_lines=1),
        Bad(
            "left and right images exchanged",
            both(
                copy("street/left", "swapped/right"),
                copy("street/right", "swapped/left"),
                copy("street/rig.yaml", "swapped"),
            ),
            "detect swapped --out results",
        ),
    ),
    "Videos": (
        Bad("a text with a video's name", put("drive.mp4", "not a video"), "detect drive.mp4 --rig recording/rig.yaml"),
        Bad(
            "a video whose header is cut off",
            both(film("drive.mp4"), cut("drive.mp4")),
            "detect drive.mp4 --rig recording/rig.yaml",
        ),
        Bad(
            "a video without one whole frame",
            both(film("drive.avi"), cut("drive.avi", 0.02)),
            "detect drive.avi --rig recording/rig.yaml",
        ),
        Bad("a video without rig", film("drive.mp4"), "detect drive.mp4"),
        Bad("the video of one camera", film("drive.mp4", 160), "detect drive.mp4 --rig recording/rig.yaml"),
        Bad(
            "a video of another size than the rig", film("drive.mp4", 400), "detect drive.mp4 --rig recording/rig.yaml"
        ),
        Bad("one of two videos is missing", film("a.mp4", 160), "detect a.mp4,b.mp4 --rig recording/rig.yaml"),
        Bad(
            "two videos of different sizes",
            both(film("a.mp4", 160), film("b.mp4", 96)),
            "detect a.mp4,b.mp4 --rig recording/rig.yaml",
        ),
        Bad(
            "two videos of different times",
            both(film("a.mp4", 160), film("b.mp4", 160, start_s=60)),
            "detect a.mp4,b.mp4 --rig recording/rig.yaml",
        ),
        Bad(
            "several videos of one side",
            both(film("drive/left.mp4", 160), film("drive/left.avi", 160), film("drive/right.mp4", 160)),
            "detect drive",
        ),
    ),
    "Rig files": (
        Bad("a rig file that is not there", command=WITH_RIG),
        Bad("a folder without rig files", lambda: Path("other").mkdir(), WITH_RIG),
        Bad("an empty rig file", put(RIG, "")),
        Bad("an image as rig file", copy(FIRST, "other"), WITH_RIG),
        Bad("a rig file of 2 MB", put("other", b"#" * 2_000_000), WITH_RIG),
        Bad("some other text", put("other", "Dear diary,\n"), WITH_RIG),
        Bad("a rig file cut short", cut(RIG, 0.95)),
        Bad("a name is missing", edit(RIG, "  cy_px: .*\n", "")),
        Bad("a name is misspelt", edit(RIG, "lens:", "lense:")),
        Bad("a name stands there twice", edit(RIG, "  lens:", "  fx_px: 3\n  lens:")),
        Bad("another version", edit(RIG, "rig: 1", "rig: 7")),
        Bad("a number that is none", edit(RIG, "fx_px: .*", "fx_px: wide")),
        Bad("NaN", edit(RIG, "fx_px: .*", "fx_px: nan")),
        Bad("a negative focal length", edit(RIG, "fx_px: ", "fx_px: -")),
        Bad("an image size of zero", edit(RIG, "size_px: .*", "size_px: [160, 0]")),
        Bad("cameras of two sizes", edit(RIG, "size_px: .*", "size_px: [160, 92]")),
        Bad("an unknown lens", edit(RIG, "lens: .*", "lens: omni")),
        Bad("coefficients that do not fit the lens", edit(RIG, "distortion: .*", "distortion: [0.1, 0.2]")),
        Bad("a rotation that is none", pose([[1, 0.1, 0, 0.2], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])),
        Bad("a mirrored rotation", pose([[1, 0, 0, 0.2], [0, -1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])),
        Bad("swapped cameras", beside(-0.2)),
        Bad("a baseline in millimetres", beside(205)),
        Bad("no baseline", beside(0)),
        Bad("one camera above the other", beside(0, 0.2)),
        Bad("cameras that look apart", pose([[0, 0, 1, 0.2], [0, 1, 0, 0], [-1, 0, 0, 0], [0, 0, 0, 1]])),
        Bad("a YAML bomb", put(RIG, BOMB)),
        Bad("YAML that would run code", edit(RIG, "lens: .*", "lens: !!python/object/apply:os.system [ls]")),
        Bad("YAML nested 100000 levels deep", put("other", "roadblock_rig: 1\nleft: " + "[" * 100_000), WITH_RIG),
        Bad("a text that may be two formats", edit(RIG, "left:", "cam0: 1\nleft:")),
        Bad("OpenCV: no image size", put("other", opencv_rig("")), "rig show other"),
        Bad(
            "OpenCV: coefficients of an unnamed lens", put("other", opencv_rig(D1="0.1, 0.2, 0., 0.")), "rig show other"
        ),
        Bad("Kalibr: three cameras", put("other", "".join(f"cam{i}:\n{CAM}" for i in range(3))), "rig show other"),
        Bad("ROS: one camera only", put("other", INFO), "rig show other"),
        Bad("ROS: not calibrated", both(put("ros/left.yaml", INFO), put("ros/right.yaml", INFO)), "rig show ros"),
        Bad("KITTI: no such cameras", put("other", KITTI_RIG), "rig show other --pair 2,3 --size 160x90"),
        Bad("calibrated at another size", command="rig show recording/rig.yaml --size 640x480"),
    ),
    "Settings": (
        Bad("a misspelt setting", command="detect recording --set match.disparites=64"),
        Bad("an assignment that is none", command="detect recording --set match"),
        Bad("a word where a number belongs", command="detect recording --set match.disparities=many"),
        Bad("a number out of range", command="detect recording --set match.disparities=100000"),
        Bad("NaN as a setting", command="detect recording --set match.sigma_px=.nan"),
        Bad("a value used as a section", command="detect recording --set match.mode=hh --set match.mode.x=1"),
        Bad("a section used as a value", command="detect recording --set match=fast"),
        Bad("a settings file that is not there", command="detect recording --settings fast.toml"),
        Bad("a settings file that is no TOML", put("fast.toml", "[match\n"), "detect recording --settings fast.toml"),
        Bad("a settings file that is no text", put("fast.toml", b"\xff\0"), "detect recording --settings fast.toml"),
        Bad(
            "a settings file nested 100000 levels deep",
            put("fast.toml", "a = " + "[" * 100_000),
            "detect recording --settings fast.toml",
        ),
        Bad(
            "an unknown setting in a file",
            put("fast.toml", "[speed]\nfast = true\n"),
            "detect recording --settings fast.toml",
        ),
        Bad("an unknown detector", command="detect recording --detector dens"),
        Bad("a detector that cannot be imported", command="detect recording --detector nowhere:make"),
        Bad("an unknown matcher", command="detect recording --set match.matcher=sgmb"),
    ),
    "Options": (
        Bad("a unit that is none", command="rig show recording/rig.yaml --unit parsec"),
        Bad("a size that is none", command="rig show recording/rig.yaml --size 640"),
        Bad("a pair that is none", command="rig show recording/rig.yaml --pair left"),
        Bad("an unknown `--format`", command="rig show recording/rig.yaml --format opencv5"),
        Bad("a `--format` that it is not", command="rig show recording/rig.yaml --format kalibr"),
        Bad("a second file for a one-file format", command="rig show recording/rig.yaml --right recording/rig.yaml"),
        Bad("`--overlay` with nowhere to draw", command="detect recording --overlay"),
    ),
    "Results": (
        Bad("`--out` is a file", put("results.txt", ""), "detect recording --out results.txt"),
        Bad("`--out` lies below a file", put("results.txt", ""), "detect recording --out results.txt/here"),
        Bad("`--out` holds somebody else's overlay", put("mine/overlay/a.png", ""), "detect recording --out mine"),
        Bad("`--out` holds somebody else's run.json", put("mine/run.json", "{}"), "detect recording --out mine"),
        Bad("a folder stands where results belong", put("mine/obstacles.jsonl/a", ""), "detect recording --out mine"),
        Bad("demo: `--out` is a file", put("results.txt", ""), "demo --out results.txt"),
        Bad("convert: an unknown format", command="rig convert recording/rig.yaml other --to zed"),
        Bad("convert: a folder stands there", command="rig convert recording/rig.yaml recording"),
        Bad("convert: a file where a folder is needed", command="rig convert recording/rig.yaml ros.yaml --to ros"),
        Bad(
            "convert: no room for the lens",
            both(edit(RIG, "lens: .*\n  distortion: .*", "lens: brown_conrady\n  distortion: [0.1, 0.2, 0, 0, 0.3]")),
            "rig convert recording/rig.yaml chain.yaml --to kalibr",
        ),
    ),
    "Evaluation": (
        Bad("evaluate: nothing to judge by", found, "evaluate found"),
        Bad("evaluate: no results", command="evaluate nowhere --truth recording"),
        Bad("evaluate: results cut short", put("found/obstacles.jsonl", FOUND[:-9]), AGAINST),
        Bad(
            "evaluate: an obstacle's box inside out",
            put("found/obstacles.jsonl", FOUND.replace("20, 20]", "20, 5]")),
            AGAINST,
        ),
        Bad("evaluate: no truth", both(found, lambda: Path("empty").mkdir()), "evaluate found --truth empty"),
        Bad(
            "evaluate: truth of another recording",
            both(found, edit("found/obstacles.jsonl", "000000", "elsewhere")),
            AGAINST,
        ),
        Bad("evaluate: a thing without a box", both(found, edit("recording/truth.jsonl", "box_px", "box")), AGAINST),
        Bad(
            "evaluate: truth of another version", both(found, put("recording/truth.jsonl", '{"schema": 2}\n')), AGAINST
        ),
        Bad(
            "evaluate: a label that is none",
            both(found, put("k/label_2/000000.txt", LABEL.replace("Car", "Boat")), put("k/calib.txt", COLOR_RIG)),
            "evaluate found --truth k",
        ),
        Bad(
            "evaluate: labels without calibration",
            both(found, put("k/label_2/000000.txt", LABEL)),
            "evaluate found --truth k",
        ),
        Bad(
            "evaluate: a calibration of one camera",
            both(found, put("k/label_2/000000.txt", LABEL), put("k/calib.txt", "P2: 1 0 0 0 0 1 0 0 0 0 1 0\n")),
            "evaluate found --truth k",
        ),
        Bad(
            "evaluate: maps without pictures",
            both(found, put("k/disp_occ_0/a.txt", ""), put("k/obj_map/a.txt", "")),
            "evaluate found --truth k",
        ),
        Bad(
            "evaluate: a true map that is no picture",
            both(found, put("k/disp_occ_0/000000.png", "no"), put("k/obj_map/a.txt", "")),
            "evaluate found --truth k",
        ),
        Bad(
            "evaluate: two true maps of two sizes",
            both(
                found,
                draw("k/disp_occ_0/000000.png", GRAY.astype(np.uint16)),
                draw("k/obj_map/000000.png", GRAY[:9]),
                put("k/calib.txt", COLOR_RIG),
            ),
            "evaluate found --truth k",
        ),
        Bad("evaluate: `--out` is a file", both(found, put("judged.txt", "")), f"{AGAINST} --out judged.txt"),
    ),
    "Calibration: what is asked for": (
        Bad("calibrate: no board", command="calibrate boards --square 25mm"),
        Bad("calibrate: a misspelt board", command=calibrate("boards", "chesboard:7x5")),
        Bad("calibrate: a board without its rows", command=calibrate("boards", "chessboard:7")),
        Bad("calibrate: a board of one row", command=calibrate("boards", "chessboard:7x1")),
        Bad("calibrate: an unknown marker dictionary", command=calibrate("boards", "charuco:7x5:5x5_77")),
        Bad("calibrate: more markers than the dictionary has", command=calibrate("boards", "charuco:14x10:4x4_50")),
        Bad("calibrate: markers larger than their squares", command=calibrate("boards", "charuco:7x5:5x5_100:1.5")),
        Bad("calibrate: no length", command="calibrate boards --board chessboard:7x5"),
        Bad("calibrate: a length without unit", command=calibrate("boards", length="--square 25")),
        Bad("calibrate: squares of 25 m", command=calibrate("boards", length="--square 25m")),
        Bad("calibrate: a unit that is none", command=calibrate("boards", length="--square 25parsec")),
        Bad("calibrate: a unit without a number", command=calibrate("boards", length="--square mm")),
        Bad("calibrate: two lengths that disagree", command=calibrate("boards", length="--square 25mm --span 175mm")),
        Bad("calibrate: an error without unit", command=calibrate("boards", length="--span 150mm --span-error 0.5")),
        Bad("calibrate: an unknown lens", command=calibrate("boards", length="--square 25mm --lens fisheye")),
        Bad(
            "calibrate: `--out` is a file",
            put("results.txt", ""),
            calibrate("boards", length="--square 25mm --out results.txt"),
        ),
        Bad(
            "calibrate: `--out` holds somebody else's rig.yaml",
            command=calibrate("boards", length="--square 25mm --out recording"),
        ),
        Bad("calibrate: a folder stands where the rig belongs", command=f"{calibrate('boards')} -o recording"),
    ),
    "Calibration: pictures": (
        Bad("calibrate: nothing is there", command=calibrate("nowhere")),
        Bad("calibrate: a pattern that matches nothing", command=calibrate("'boards/l*.jpg' 'boards/r*.jpg'")),
        Bad("calibrate: an empty folder", lambda: Path("shots").mkdir(), calibrate()),
        Bad("calibrate: no picture", put("notes.pdf", b"%PDF"), calibrate("notes.pdf boards/right")),
        Bad("calibrate: pictures of one camera", command=calibrate("boards/left")),
        Bad("calibrate: left pictures only", copy("boards/left/00.png", "shots/left00.png"), calibrate()),
        Bad("calibrate: one folder for both cameras", command=calibrate("boards/left boards/left")),
        Bad(
            "calibrate: a folder of left, right and others",
            both(*(copy("boards/left/00.png", f"shots/{name}.png") for name in ("left1", "right1", "room"))),
            calibrate(),
        ),
        Bad(
            "calibrate: several pairs of folders",
            both(shots("00"), copy("boards/left", "shots/l"), copy("boards/right", "shots/r")),
            calibrate(),
        ),
        Bad(
            "calibrate: nothing pairs", both(shots("00"), move("shots/right/00.png", "shots/right/50.png")), calibrate()
        ),
        Bad(
            "calibrate: two pictures of one moment",
            both(shots("00", "01"), copy("boards/left/00.png", "shots/left/00.bmp")),
            calibrate(),
        ),
        Bad(
            "calibrate: a picture of another size",
            both(shots("00", "01"), draw("shots/left/01.png", GRAY)),
            calibrate(),
        ),
        Bad(
            "calibrate: cameras of two sizes",
            both(shots("00", "01"), each("shots/right", lambda image: image[:200])),
            calibrate(),
        ),
        Bad("calibrate: a picture cut short", both(shots("00", "01"), cut("shots/right/01.png")), calibrate()),
        Bad("calibrate: a text with a picture's name", both(shots("00"), put("shots/left/00.png", "no")), calibrate()),
        Bad("calibrate: the left pictures copied to the right", shots("00", right="left"), calibrate()),
        Bad("calibrate: a video and pictures", film("a.mp4"), calibrate("a.mp4 boards/right")),
        Bad("calibrate: one video for both cameras", film("a.mp4"), calibrate("a.mp4 a.mp4")),
        Bad("calibrate: two videos of two sizes", both(film("a.mp4"), film("b.mp4", 96)), calibrate("a.mp4 b.mp4")),
        Bad("calibrate: the video of one camera", film("a.mp4", 160), calibrate("a.mp4")),
        Bad("calibrate: a video cut short", both(film("a.mp4"), cut("a.mp4")), calibrate("a.mp4")),
    ),
    "Calibration: what they show": (
        Bad("calibrate: no board in any picture", command=calibrate("street")),
        Bad("calibrate: another board than was said", shots("00", "01", "02"), calibrate(board="chessboard:9x6")),
        Bad(
            "calibrate: squares counted instead of corners", shots("00", "01", "02"), calibrate(board="chessboard:8x6")
        ),
        Bad(
            "calibrate: one camera never sees the board",
            both(shots("00", "01", "02"), each("shots/right", noise)),
            calibrate(),
        ),
        Bad(
            "calibrate: never both cameras at once",
            both(
                shots("00", "01", "02", "03"),
                *(draw(f"shots/left/{n}.png", np.full((240, 320), 90, np.uint8)) for n in ("00", "01")),
                *(draw(f"shots/right/{n}.png", np.full((240, 320), 95, np.uint8)) for n in ("02", "03")),
            ),
            calibrate(),
        ),
        Bad("calibrate: two views", shots("00", "01"), calibrate()),
        Bad("calibrate: left and right exchanged", shots(left="right", right="left"), calibrate()),
        Bad(
            "calibrate: mirrored pictures of both cameras",
            both(shots(), each("shots/left", mirrored), each("shots/right", mirrored)),
            calibrate(),
        ),
        Bad("calibrate: mirrored pictures of one camera", both(shots(), each("shots/left", mirrored)), calibrate()),
    ),
}
