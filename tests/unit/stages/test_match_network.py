"""Stereo networks of one's own: a small one that truly matches, built here out of standard operators."""

from pathlib import Path

import numpy as np
import onnx
import pytest
import yaml
from onnx import TensorProto, helper, numpy_helper

from roadblock.config import load_settings
from roadblock.errors import SettingsError
from roadblock.geometry.pose import pose
from roadblock.pipeline import Pipeline
from roadblock.stages.match import MatchSettings, match, stereo_network
from roadblock.values.camera import Camera, Rectification, StereoRig
from roadblock.values.frame import RectifiedPair, StereoPair

WIDE, TALL, DISPARITIES, WINDOW = 160, 96, 24, 7


def block_matcher(path: Path, size: tuple[int, int] = (WIDE, TALL), channels: int = 1) -> Path:
    """Write a network that compares windows of both images at every disparity and takes the best; right image first."""
    shape = [1, channels, size[1], size[0]]
    nodes, costs, constants = [], [], []
    for d in range(DISPARITIES):
        constants.append(numpy_helper.from_array(np.array([0, 0, 0, d, 0, 0, 0, 0], np.int64), f"pads{d}"))
        constants.append(numpy_helper.from_array(np.array([size[0]], np.int64), f"end{d}"))
        nodes += [
            helper.make_node("Pad", ["right", f"pads{d}", "far"], [f"padded{d}"]),
            helper.make_node("Slice", [f"padded{d}", "zero", f"end{d}", "three"], [f"moved{d}"]),
            helper.make_node("Sub", ["left", f"moved{d}"], [f"difference{d}"]),
            helper.make_node("Abs", [f"difference{d}"], [f"absolute{d}"]),
            helper.make_node(
                "AveragePool", [f"absolute{d}"], [f"cost{d}"], kernel_shape=[WINDOW, WINDOW], pads=[WINDOW // 2] * 4
            ),
            helper.make_node("ReduceMean", [f"cost{d}"], [f"mean{d}"], axes=[1], keepdims=1),
        ]
        costs.append(f"mean{d}")
    nodes += [
        helper.make_node("Concat", costs, ["volume"], axis=1),
        helper.make_node("ArgMin", ["volume"], ["index"], axis=1, keepdims=1),
        helper.make_node("Cast", ["index"], ["disparity"], to=TensorProto.FLOAT),
        helper.make_node("ReduceMin", ["volume"], ["least"], axes=[1], keepdims=1),
        helper.make_node("Neg", ["least"], ["confidence"]),
    ]
    constants += [
        numpy_helper.from_array(np.array(1e4, np.float32), "far"),
        numpy_helper.from_array(np.array([0], np.int64), "zero"),
        numpy_helper.from_array(np.array([3], np.int64), "three"),
    ]
    inputs = [helper.make_tensor_value_info(name, TensorProto.FLOAT, shape) for name in ("right", "left")]
    outputs = [
        helper.make_tensor_value_info(name, TensorProto.FLOAT, [1, 1, *shape[2:]])
        for name in ("disparity", "confidence")
    ]
    graph = helper.make_graph(nodes, "blocks", inputs, outputs, constants)
    onnx.save(helper.make_model(graph, opset_imports=[helper.make_opsetid("", 13)], ir_version=8), path)
    return path


def described(folder: Path, **changes: object) -> MatchSettings:
    """Write network and description, and return the settings that name it."""
    block_matcher(folder / "blocks.onnx")
    about = {"model": "blocks.onnx", "input_px": [WIDE, TALL], "colors": "gray", "left": "left", **changes}
    (folder / "blocks.yaml").write_text(yaml.safe_dump({k: v for k, v in about.items() if v is not None}), "utf-8")
    return MatchSettings(matcher="onnx", network=str(folder / "blocks.yaml"))


def pair(width: int, height: int, d_px: int, channels: int = 0) -> RectifiedPair:
    """A texture, coarse enough to be shrunk, that moves by whole pixels."""
    rng = np.random.default_rng(1)
    coarse = rng.integers(20, 235, (height // 4 + 1, (width + d_px) // 4 + 1)).astype(np.uint8)
    wide = np.kron(coarse, np.ones((4, 4), np.uint8))[:height, : width + d_px]
    left = np.ascontiguousarray(wide[:, :width])
    right = np.ascontiguousarray(np.roll(left, -d_px, axis=1))
    if channels:
        left, right = (np.repeat(image[..., None], channels, axis=-1) for image in (left, right))
    return RectifiedPair(left, right, Rectification(100.0, width / 2, height / 2, 0.2, (width, height)))


def test_a_network_matches(tmp_path: Path) -> None:
    d_px = match(pair(WIDE, TALL, 9), described(tmp_path)).d_px
    assert d_px.dtype == np.float32
    inner = d_px[8:-8, 30:-30]
    assert (inner == 9).mean() > 0.99
    assert np.isnan(d_px[:, 0]).all(), "what lies left of the right image is no match"


@pytest.mark.parametrize("keep_shape", [True, False])
def test_other_sizes_are_scaled_there_and_back(tmp_path: Path, keep_shape: bool) -> None:
    """Twice as wide and as high, or not as high: shrunk by two across, and 16 px become 8 of the network's."""
    images = pair(2 * WIDE, 2 * TALL - 32, 16)
    d_px = match(images, described(tmp_path, keep_shape=keep_shape)).d_px
    assert d_px.shape == (2 * TALL - 32, 2 * WIDE)
    assert np.nanmedian(d_px[20:-20, 60:-60]) == 16
    assert (np.abs(d_px[20:-20, 60:-60] - 16) <= 2).mean() > 0.9


def test_units_and_confidence_are_the_descriptions(tmp_path: Path) -> None:
    images = pair(WIDE, TALL, 9)
    assert np.nanmedian(match(images, described(tmp_path, scale=0.5)).d_px[8:-8, 30:-30]) == 4.5
    sure = match(images, described(tmp_path, confidence="confidence", least_confidence=-1.0)).d_px
    assert np.isfinite(sure[8:-8, 30:-30]).mean() > 0.95
    none = match(images, described(tmp_path, confidence="confidence", least_confidence=1.0)).d_px
    assert np.isnan(none).all()


def test_left_is_who_is_named(tmp_path: Path) -> None:
    """Without a name the first input, which is the right image here, is taken for the left one: nothing matches."""
    d_px = match(pair(WIDE, TALL, 9), described(tmp_path, left=None)).d_px
    assert not (d_px[8:-8, 30:-30] == 9).mean() > 0.1


def test_blank_places_stay_unknown(tmp_path: Path) -> None:
    images = pair(WIDE, TALL, 9)
    left, right = (np.array(image) for image in (images.left, images.right))
    left[30:70, 60:110], right[30:70, 51:101] = 128, 128
    d_px = match(RectifiedPair(left, right, images.rectification), described(tmp_path)).d_px
    assert np.isnan(d_px[42:58, 74:98]).all()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"model": "gone.onnx"}, "cannot read the network"),
        ({"left": "middle"}, "no input 'middle'; it has: right, left"),
        ({"output": "depth"}, "no output 'depth'; it has: disparity, confidence"),
        ({"input_px": [64, 48]}, r"takes an input of \[1, 1, 96, 160\], but input_px says \[1, 1, 48, 64\]"),
        ({"colors": "rgb"}, "but input_px says"),
        ({"colours": "rgb"}, "colours: Extra inputs are not permitted"),
    ],
)
def test_what_does_not_fit_is_said(tmp_path: Path, changes: dict[str, object], message: str) -> None:
    with pytest.raises(SettingsError, match=message):
        stereo_network(described(tmp_path, **changes))


def test_no_network_and_one_image_are_refused(tmp_path: Path) -> None:
    with pytest.raises(SettingsError, match=r"set match\.network"):
        stereo_network(MatchSettings(matcher="onnx"))
    settings = described(tmp_path)
    shape = [1, 1, TALL, WIDE]
    infos = [helper.make_tensor_value_info(name, TensorProto.FLOAT, shape) for name in ("image", "out")]
    graph = helper.make_graph([helper.make_node("Identity", ["image"], ["out"])], "one", infos[:1], infos[1:])
    onnx.save(
        helper.make_model(graph, opset_imports=[helper.make_opsetid("", 13)], ir_version=8), tmp_path / "blocks.onnx"
    )
    with pytest.raises(SettingsError, match=r"must take 2 image\(s\) of numbers, but takes: image"):
        stereo_network(settings)


def test_an_output_of_another_size_is_refused(tmp_path: Path) -> None:
    settings = described(tmp_path)
    network = stereo_network(settings)
    network.session.run = lambda *_: [np.zeros((1, 1, 5, 7), np.float32)]  # type: ignore[method-assign]
    with pytest.raises(SettingsError, match=r"output \[1, 1, 5, 7\] is no image of 160x96 px"):
        match(pair(WIDE, TALL, 9), settings)


@pytest.mark.parametrize("channels", [0, 3])
def test_the_pipeline_takes_it_and_names_its_hash(tmp_path: Path, channels: int) -> None:
    settings = described(tmp_path)
    camera = Camera((WIDE, TALL), 100.0, 100.0, WIDE / 2, TALL / 2)
    rig = StereoRig(camera, camera, pose(np.eye(3), [0.2, 0, 0]))
    pipeline = Pipeline(
        rig, load_settings(None, ["detector=dense", "match.matcher=onnx", f"match.network={settings.network}"])
    )
    assert pipeline.matcher_sha256 == stereo_network(settings).session.sha256
    assert Pipeline(rig, load_settings(None, [])).matcher_sha256 is None
    images = pair(WIDE, TALL, 9, channels)
    result, _ = pipeline.step(StereoPair(images.left, images.right))
    assert result.obstacles
    assert result.obstacles[0].range_m == pytest.approx(100 * 0.2 / 9, rel=0.05)
