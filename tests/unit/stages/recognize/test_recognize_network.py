"""Networks of one's own: tiny ones that the tests build, and a real one where it is there."""

import hashlib
import os
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import onnx
import pytest
import yaml
from onnx import TensorProto, helper, numpy_helper
from test_recognize_shape import cells_of, recognized, scene

from roadblock.config import Settings
from roadblock.errors import MissingExtraError, SettingsError
from roadblock.geometry.pose import pose
from roadblock.io.sources import open_source
from roadblock.pipeline import Pipeline
from roadblock.stages.recognize import RecognizeSettings, make_recognizer
from roadblock.stages.recognize.description import NetworkDescription, read_description
from roadblock.stages.recognize.layouts import Seen, decode
from roadblock.stages.recognize.network import named, prepared
from roadblock.stages.recognize.session import Session
from roadblock.values.camera import Camera, StereoRig

INPUT = (64, 48)
PLAIN = {"model": "tiny.onnx", "layout": "yolov8", "input_px": INPUT, "classes": {0: "person", 2: "car"}}


def tiny(path: Path, *outputs: np.ndarray, shape: tuple = (1, 3, 48, 64), kind: int = TensorProto.FLOAT) -> Path:
    """Write a network that takes an image and always says the same."""
    names = [f"out{i}" for i in range(len(outputs))]
    nodes = [
        helper.make_node("Constant", [], [n], value=numpy_helper.from_array(a))
        for n, a in zip(names, outputs, strict=True)
    ]
    nodes.append(helper.make_node("Identity", ["image"], ["seen"]))
    infos = [helper.make_tensor_value_info(n, TensorProto.FLOAT, a.shape) for n, a in zip(names, outputs, strict=True)]
    infos.append(helper.make_tensor_value_info("seen", kind, shape))
    graph = helper.make_graph(nodes, "tiny", [helper.make_tensor_value_info("image", kind, shape)], infos)
    onnx.save(helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=9), path)
    return path


def about(**changes: object) -> NetworkDescription:
    return NetworkDescription.model_validate(PLAIN | changes)


def described(folder: Path, **changes: object) -> RecognizeSettings:
    """Write a description, and return the settings that name it."""
    text = {k: list(v) if isinstance(v, tuple) else v for k, v in (PLAIN | changes).items()}
    (folder / "tiny.yaml").write_text(yaml.safe_dump(text), "utf-8")
    return RecognizeSettings(recognizer="onnx", network=str(folder / "tiny.yaml"))


def yolov8(*rows: tuple[float, ...], count: int = 30) -> np.ndarray:
    """Return (1, 7, count): boxes of three classes."""
    out = np.zeros((1, 7, count), np.float32)
    for i, row in enumerate(rows):
        out[0, :, i] = row
    return out


# --- what the layouts say ---------------------------------------------------------------------------------------------


def test_yolov8_boxes_come_once_and_the_surest_first() -> None:
    out = yolov8(
        (20, 10, 8, 6, 0.1, 0, 0.6), (20.5, 10, 8, 6, 0, 0, 0.9), (50, 30, 4, 4, 0.7, 0, 0), (9, 9, 2, 2, 0.1, 0, 0)
    )
    seen = decode([out], about())
    np.testing.assert_allclose(seen.boxes, [[16.5, 7, 24.5, 13], [48, 28, 52, 32]])
    np.testing.assert_allclose(seen.scores, [0.9, 0.7])
    assert seen.numbers.tolist() == [2, 0]


def test_yolox_boxes_lie_on_grids() -> None:
    """64 x 48 px with strides 8, 16, 32: 48 + 12 + 2 cells; cell (5, 2) of the first, and (1, 0) of the last."""
    out = np.zeros((1, 62, 8), np.float32)
    out[0, 2 * 8 + 5] = (0.5, 0.25, np.log(2), np.log(3), 0.8, 0, 0, 1.0)
    out[0, 61] = (0.5, 0.5, 0, 0, 0.5, 0.9, 0, 0)
    seen = decode([out], about(layout="yolox", strides=(8, 16, 32), input_px=(64, 48)))
    np.testing.assert_allclose(seen.boxes[0], [44 - 8, 18 - 12, 44 + 8, 18 + 12], rtol=1e-6)
    np.testing.assert_allclose(seen.boxes[1], [32, 0, 64, 32], rtol=1e-6)
    np.testing.assert_allclose(seen.scores, [0.8, 0.45], rtol=1e-6)


def test_yolox_may_come_decoded() -> None:
    out = np.zeros((1, 20, 8), np.float32)
    out[0, 3] = (30, 20, 10, 8, 0.9, 0, 0, 0.9)
    seen = decode([out], about(layout="yolox", decoded=True))
    np.testing.assert_allclose(seen.boxes, [[25, 16, 35, 24]])


def test_rtdetr_boxes_are_shares_and_scores_logits() -> None:
    boxes = np.array([[[0.5, 0.5, 0.25, 0.5], [0.1, 0.1, 0.1, 0.1]]], np.float32)
    logits = np.array([[[-9, -9, np.log(3)], [-9, -9, -9]]], np.float32)
    seen = decode([boxes, logits], about(layout="rtdetr"))
    np.testing.assert_allclose(seen.boxes, [[24, 12, 40, 36]])
    np.testing.assert_allclose(seen.scores, [0.75], rtol=1e-6)


def test_ssd_boxes_are_corners_of_either_order() -> None:
    boxes = np.array([[[0.25, 0.5, 0.75, 1.0]]], np.float32)
    numbers, scores = np.array([[2.0]], np.float32), np.array([[0.6]], np.float32)
    np.testing.assert_allclose(decode([boxes, numbers, scores], about(layout="ssd")).boxes, [[32, 12, 64, 36]])
    seen = decode([boxes, numbers, scores], about(layout="ssd", boxes="xyxy"))
    np.testing.assert_allclose(seen.boxes, [[16, 24, 48, 48]])
    assert seen.numbers.tolist() == [2]


@pytest.mark.parametrize(
    ("layout", "shapes", "message"),
    [
        ("yolov8", [(1, 30, 7)], r"outputs \(1, 30, 7\) are not of layout yolov8"),
        ("yolov8", [(1, 7, 30), (1, 2)], "layout yolov8"),
        ("yolox", [(1, 7, 30)], "layout yolox"),
        ("yolox", [(1, 61, 8)], "gives 61 boxes, but an input of 64x48 px with strides .* has 62"),
        ("rtdetr", [(1, 9, 4)], "layout rtdetr"),
        ("rtdetr", [(1, 9, 4), (1, 8, 3)], "layout rtdetr"),
        ("ssd", [(1, 9, 4), (1, 9)], "layout ssd"),
        ("rtdetr", [(1, 9, 4), (1, 9, 2)], "names class 2, but the network has 2 classes"),
    ],
)
def test_other_outputs_are_refused(layout: str, shapes: list[tuple[int, ...]], message: str) -> None:
    with pytest.raises(SettingsError, match=message):
        decode([np.zeros(shape, np.float32) for shape in shapes], about(layout=layout))


# --- the image it gets ------------------------------------------------------------------------------------------------


def test_the_image_keeps_its_shape_and_is_padded() -> None:
    image = np.zeros((60, 128, 3), np.uint8)
    image[..., 0], image[..., 2] = 200, 50
    made, scale, shift = prepared(image, about(colors="bgr", mean=(10, 0, 0), std=(2, 1, 1)))
    assert made.shape == (1, 3, 48, 64)
    assert (scale.tolist(), shift.tolist()) == ([0.5, 0.5], [0, 0])
    assert made[0, :, 5, 5].tolist() == [20, 0, 200]
    assert made[0, :, 35, 5].tolist() == [52, 114, 114]
    _, _, shift = prepared(image, about(centered=True))
    assert shift.tolist() == [0, 9]


def test_the_image_may_be_stretched_grey_or_deep() -> None:
    _, scale, _ = prepared(np.zeros((60, 128, 3), np.uint8), about(letterbox=False))
    assert scale.tolist() == [0.5, 0.8]
    made, _, _ = prepared(np.full((48, 64), 77 * 257, np.uint16), about())
    assert (made == 77).all()


# --- whose box it is --------------------------------------------------------------------------------------------------

BOX = (250, 91, 371, 227)


def test_the_obstacle_takes_the_type_of_the_box_it_lies_in() -> None:
    wall = recognized(cells_of(BOX), box=BOX).recognized(label="wall")
    behind = wall.recognized(range_m=30.0)
    aside = wall.recognized(box_px=(400, 91, 500, 227))
    seen = Seen(np.array([[240, 80, 380, 230.0]]), np.array([0.8]), np.array([2]))
    car, far, other = named((wall, behind, aside), seen, about())
    assert (car.label, car.probability, car.class_odds) == ("car", 0.8, {"car": 0.8, "unknown": pytest.approx(0.2)})
    assert (far.label, other.label) == ("wall", "wall")


def test_pieces_of_one_thing_take_one_type_and_the_surest_box_speaks_first() -> None:
    whole = recognized(cells_of(BOX), box=BOX).recognized(label="unknown")
    left, right = (
        whole.recognized(box_px=(250, 91, 320, 227)),
        whole.recognized(box_px=(321, 91, 371, 227), range_m=10.8),
    )
    boxes = np.array([[245, 85, 375, 230.0], [245, 85, 325, 230], [0, 0, 20, 20], [245, 85, 325, 230]])
    seen = Seen(boxes, np.array([0.9, 0.8, 0.7, 0.6]), np.array([2, 0, 0, 1]))
    assert [o.label for o in named((left, right), seen, about())] == ["car", "car"]


def test_a_class_may_be_unknown_on_purpose() -> None:
    wall = recognized(cells_of(BOX), box=BOX).recognized(label="wall", probability=0.7)
    seen = Seen(np.array([[240, 80, 380, 230.0]]), np.array([0.8]), np.array([1]))
    found = named((wall,), seen, about(classes={1: "unknown"}))[0]
    assert found.label == "unknown"
    assert np.isnan(found.probability)


def test_a_network_that_sees_nothing_loses_nothing(tmp_path: Path) -> None:
    tiny(tmp_path / "tiny.onnx", yolov8())
    pair, found, regions, obstacles = scene(cells_of(BOX), (186, 36, 34), BOX)
    recognizer = make_recognizer(described(tmp_path, outputs=["out0"]))
    seen = recognizer(pair, found, regions, obstacles)
    alone = make_recognizer(RecognizeSettings())(pair, found, regions, obstacles)
    assert [(o.label, o.color, o.range_m) for o in seen] == [(o.label, o.color, o.range_m) for o in alone]
    assert recognizer(pair, replace(found, regions=()), (), ()) == ()


def test_a_network_names_what_stands_in_the_image(tmp_path: Path) -> None:
    """The pair is 611 x 301: scaled by 64/611, the box BOX is centred on (32.5, 16.7) and 12.7 x 14.2 large."""
    tiny(tmp_path / "tiny.onnx", yolov8((32.5, 16.7, 12.7, 14.2, 0, 0, 0.95)))
    pair, found, regions, obstacles = scene(cells_of(BOX), (186, 36, 34), BOX)
    seen = make_recognizer(described(tmp_path, outputs=["out0"]))(pair, found, regions, obstacles)[0]
    assert (seen.label, seen.color) == ("car", "red")
    assert seen.probability == pytest.approx(0.95)


# --- what is refused --------------------------------------------------------------------------------------------------


def test_onnx_needs_a_description() -> None:
    with pytest.raises(SettingsError, match=r"set recognize\.network"):
        make_recognizer(RecognizeSettings(recognizer="onnx"))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (None, "No such file"),
        ("a: [", "cannot be read as the description"),
        ("- 1", "the file: "),
        ("model: a.onnx\nlayout: yolo9\ninput_px: [8, 8]\nclasses: {0: car}", "layout: "),
        ("model: a.onnx\nlayout: yolox\ninput_px: [8, 8]\nclasses: {0: lorry}", r"classes\.0: .*our types: person"),
    ],
)
def test_a_wrong_description_is_refused(tmp_path: Path, text: str | None, message: str) -> None:
    path = tmp_path / "net.yaml"
    if text is not None:
        path.write_text(text, "utf-8")
    with pytest.raises(SettingsError, match=message):
        read_description(path)


def test_a_network_must_be_there_and_be_one(tmp_path: Path) -> None:
    with pytest.raises(SettingsError, match="cannot read the network"):
        make_recognizer(described(tmp_path))
    (tmp_path / "tiny.onnx").write_bytes(b"no network")
    with pytest.raises(SettingsError, match="no network that ONNX Runtime can run"):
        make_recognizer(described(tmp_path))


def test_a_network_must_take_the_described_image(tmp_path: Path) -> None:
    tiny(tmp_path / "tiny.onnx", yolov8(), shape=(1, 3, 32, 64))
    with pytest.raises(SettingsError, match=r"takes an input of \[1, 3, 32, 64\], but input_px says \[1, 3, 48, 64\]"):
        make_recognizer(described(tmp_path))
    tiny(tmp_path / "tiny.onnx", yolov8(), kind=TensorProto.INT64)
    with pytest.raises(SettingsError, match="must take one image of numbers"):
        make_recognizer(described(tmp_path))


def test_a_named_output_must_exist(tmp_path: Path) -> None:
    tiny(tmp_path / "tiny.onnx", yolov8())
    with pytest.raises(SettingsError, match="no output 'boxes'; it has: out0"):
        make_recognizer(described(tmp_path, outputs=["boxes"]))


def test_a_network_that_fails_says_so(tmp_path: Path) -> None:
    session = Session(tiny(tmp_path / "tiny.onnx", yolov8()))
    with pytest.raises(SettingsError, match="the network failed"):
        session.run(np.zeros((1, 3, 5, 5), np.float32), ())


def test_the_network_is_known_by_its_hash(tmp_path: Path) -> None:
    path = tiny(tmp_path / "tiny.onnx", yolov8())
    known = hashlib.sha256(path.read_bytes()).hexdigest()
    camera = Camera((64, 48), 60.0, 60.0, 31.0, 23.0)
    rig = StereoRig(camera, camera, pose(np.eye(3), [0.2, 0, 0]))
    settings = Settings(recognize=described(tmp_path, outputs=["out0"]))
    assert Session(path).sha256 == Pipeline(rig, settings).network_sha256 == known
    assert Pipeline(rig).network_sha256 is None


def test_without_the_library_the_extra_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "onnxruntime", None)
    with pytest.raises(MissingExtraError, match=r"roadblock\[onnx\]"):
        Session(tmp_path / "tiny.onnx")


# --- for real ---------------------------------------------------------------------------------------------------------

DATA = Path(os.environ.get("ROADBLOCK_DATA", Path(__file__).parents[5] / "shared" / "data"))
YOLOX = DATA / "models" / "yolox_nano.onnx"


@pytest.mark.skipif(not (YOLOX.is_file() and (DATA / "kitti2015").is_dir()), reason="no real network or recording here")
def test_a_real_network_sees_the_cyclist_and_the_van(tmp_path: Path) -> None:
    """KITTI 2015, frame 000002: a cyclist at 6 m and a white van at 13 m; nothing is lost."""
    text = f"model: {YOLOX}\nlayout: yolox\ninput_px: [416, 416]\ncolors: bgr\nleast_score: 0.25\n"
    (tmp_path / "yolox.yaml").write_text(text + "classes: {0: person, 1: bicycle, 2: car, 7: truck}\n", "utf-8")
    source = open_source(DATA / "kitti2015")
    pair = next(iter(source))
    rig = source.rigs[0] if source.rigs else source.rig
    plain, seen = (
        Pipeline(rig, Settings(recognize=settings)).step(pair)[0].obstacles
        for settings in (
            RecognizeSettings(),
            RecognizeSettings(recognizer="onnx", network=str(tmp_path / "yolox.yaml")),
        )
    )
    assert [o.box_px for o in plain] == [o.box_px for o in seen]
    near = {o.label for o in seen if o.range_m < 15}
    assert near & {"person", "bicycle"}
    assert near & {"car", "truck"}
