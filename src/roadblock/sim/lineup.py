"""Targets side by side at one range, for measuring ranges: as many pictures as it takes to show each of them whole."""

from dataclasses import dataclass

import numpy as np

from roadblock.sim.conditions import Effects
from roadblock.sim.road import Road
from roadblock.sim.scene import Scene, camera_pose, on_road, roadside
from roadblock.sim.sensor import Sensor
from roadblock.sim.things import COLORS, Order, build
from roadblock.values.camera import StereoRig


@dataclass(frozen=True)
class Target:
    """What stands in the line: an order, which way it faces (degrees; None = any), and the room it takes.

    `face_m` is how far behind its nearest face its surface still counts as the target; None = all of it.
    """

    name: str
    order: Order
    yaw_deg: float | None
    width_m: float
    face_m: float | None = None


TARGETS = (
    Target("person", Order("person", 0), None, 0.75),
    Target("bicycle_side", Order("bicycle", 0), 90.0, 1.9),
    Target("bicycle_rear", Order("bicycle", 0), 0.0, 0.75),
    Target("car_rear", Order("car", 0), 0.0, 1.95),
    Target("fork", Order("fork", 0, length_m=2.5), 0.0, 1.4, face_m=0.3),
    Target("box", Order("box", 0, model="crate", length_m=0.3, width_m=0.3, height_m=0.3), 0.0, 0.45),
    Target("railing", Order("railing", 0, length_m=1.5), 90.0, 1.7),
)

GREY_NOISE = 2.0
"""Standard deviation at mid grey of what `CAMERA` adds, grey levels."""

CAMERA = Effects(
    Sensor(
        exposure=None, psf_px=0.45, full_well_e=7690, read_noise=1.41, gain=(1.0, 1.03), offset=(0.0, 0.5), color=False
    )
)
"""A grey camera: noise of two grey levels, half of its variance from reading; contrasts 1.4 % apart."""

GAP_M = 0.3


def lineup(seed: int, range_m: float, rig: StereoRig) -> list[tuple[Scene, dict[int, Target]]]:
    """Return scenes that show every target once, each 5 % nearer or farther than `range_m`, and what their ids are.

    The seed draws order, looks, colours, background, pitch and roll.
    """
    rng = np.random.default_rng([seed, round(range_m), 3])
    waiting = [TARGETS[i] for i in rng.permutation(len(TARGETS))]
    room_m = 0.85 * rig.left.size_px[0] / rig.left.fx_px * range_m - GAP_M
    scenes: list[tuple[Scene, dict[int, Target]]] = []
    while waiting:
        shown: list[Target] = []
        for target in list(waiting):
            if not shown or sum(t.width_m + GAP_M for t in [*shown, target]) <= room_m:
                shown.append(target)
                waiting.remove(target)
        scenes.append(_scene(shown, room_m, range_m, rng, seed * 10 + len(scenes)))
    return scenes


def _scene(
    shown: list[Target], room_m: float, range_m: float, rng: np.random.Generator, seed: int
) -> tuple[Scene, dict[int, Target]]:
    used_m = sum(target.width_m + GAP_M for target in shown)
    whole_m = max(used_m, min(room_m, used_m + 4))
    left_m, free_m, things = whole_m / 2, (whole_m - used_m) / (len(shown) + 1), []
    for number, target in enumerate(shown, 1):
        left_m -= free_m + (target.width_m + GAP_M) / 2
        turn = rng.uniform(0, 360) if target.yaw_deg is None else target.yaw_deg + rng.uniform(-8, 8)
        if target.name == "fork":
            turn = 0.0
        walks = target.order.type == "person" and bool(rng.integers(2))
        color = "" if target.name == "fork" else list(COLORS)[rng.integers(len(COLORS))]
        order = Order(**{**vars(target.order), "number": number, "color": color, "walking": walks})
        thing = build(Order(**{**vars(order), "seed": int(rng.integers(2**30))}))
        things.append(on_road(thing, Road(), range_m * (1 + rng.uniform(-0.05, 0.05)), left_m, np.radians(turn)))
        left_m -= (target.width_m + GAP_M) / 2
    camera = camera_pose(1.4, np.radians(rng.normal(1, 0.5)), np.radians(rng.normal(0, 0.3)))
    scenery = roadside(np.random.default_rng(seed))
    return Scene((*things, *scenery), Road(), camera, seed=seed), dict(enumerate(shown, 1))
