"""Streets full of things of every type, for training and judging recognition: `street(seed, unseen)`.

Each type comes in families of shapes (`recognition_shapes.py`, `recognition_more.py`). Training draws from `SEEN` and
`LATER`, the judge from `UNSEEN`: other families altogether, at other seeds. Sizes and colours vary within a family,
rigs and light from street to street.
"""

import json
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from recognition_more import (
    JEEP,
    LOW,
    STRETCHED,
    TALL,
    acacia,
    any_box,
    any_car,
    any_fork,
    bollard_lamp,
    cables,
    chair,
    container,
    couple,
    crowd_barrier,
    curtain_truck,
    digger,
    double_rail,
    dustbin,
    grasses,
    heap,
    in_wheelchair,
    kiosk,
    laden_front,
    low_wall,
    mixer,
    panel_van,
    panelled,
    panes,
    parked_bicycles,
    poplar,
    racer,
    rails_of_any_kind,
    refuse_truck,
    rough,
    signal_arm,
    sitting,
    stacked,
    tandem,
    thicket,
    timber_pole,
    timber_truck,
    upright_rider,
    with_basket_cart,
    with_caravan,
    with_child_behind,
    with_dog,
    with_hand_truck,
    with_parcel,
    with_pole_over_shoulder,
    with_roof_load,
    with_trailer,
)
from recognition_shapes import (
    BODY,
    ESTATE,
    MICRO,
    MINIVAN,
    PICKUP,
    Family,
    Rng,
    attenuator_fork,
    barrel,
    between,
    birch,
    block,
    box_truck,
    bus,
    bush,
    cargo_bike,
    case,
    clipped_balls,
    column,
    concrete_fork,
    conifer,
    courier,
    cushion_fork,
    drawn_car,
    flatbed,
    folding_bicycle,
    gabions,
    guard_rail,
    half_round_fork,
    hedge_of,
    home,
    in_poncho,
    in_skirt,
    jersey,
    laden_bicycle,
    lamp,
    lattice,
    leafy,
    mast,
    mesh,
    ordered,
    pallets,
    pickets,
    pillared,
    planks,
    planted_fork,
    plated_fork,
    post_van,
    rider,
    sack,
    semitrailer,
    shed,
    site_fence,
    tanker,
    tipper,
    traffic_light,
    two_plates,
    usual_fork,
    walker,
    willow,
    with_board,
    with_pram,
    with_suitcase,
    with_umbrella,
)

from roadblock.geometry.pose import pose
from roadblock.sim.conditions import CONDITIONS
from roadblock.sim.photograph import photograph
from roadblock.sim.render import Quality
from roadblock.sim.road import Line, Road
from roadblock.sim.scene import Scene, camera_pose, on_road
from roadblock.sim.scenes import to_sun
from roadblock.sim.solids import Part, Rgb, Thing, box
from roadblock.sim.things import CARS, COLORS, shaded
from roadblock.values.camera import Camera, StereoRig

Floats = NDArray[np.float64]

SEEN: dict[str, tuple[Family, ...]] = {
    "person": (walker, ordered("person", walking=True)),
    "bicycle": (rider, ordered("bicycle", height_m=between(0.85, 1.1))),
    "car": (*(drawn_car(CARS[name]) for name in ("small", "medium", "large")), ordered("van")),
    "truck": (box_truck, bus),
    "railing": (
        ordered("railing", length_m=between(2, 9), height_m=between(0.8, 1.3)),
        ordered("railing", model="beams", length_m=between(3, 16), height_m=between(0.6, 0.9)),
        pickets,
    ),
    "pole": (ordered("pole"), ordered("pole", model="round"), ordered("pole", model="triangle"), lamp),
    "fork": (usual_fork, cushion_fork, half_round_fork),
    "wall": (ordered("wall", width_m=between(2, 8), height_m=between(0.8, 2.6)), home),
    "vegetation": (hedge_of, leafy),
    "debris": (
        ordered("box", length_m=between(0.3, 0.9), width_m=between(0.3, 0.9), height_m=between(0.42, 0.8)),
        ordered(
            "box", model="crate", length_m=between(0.4, 0.9), width_m=between(0.4, 0.9), height_m=between(0.42, 0.8)
        ),
        ordered("cone", height_m=between(0.5, 0.95)),
        ordered("stone", length_m=between(0.5, 0.9)),
    ),
}
MORE: dict[str, tuple[Family, ...]] = {
    "person": (in_skirt, with_umbrella, with_suitcase),
    "bicycle": (courier, laden_bicycle, cargo_bike),
    "car": (drawn_car(CARS["saloon"]), drawn_car(PICKUP), drawn_car(MINIVAN)),
    "truck": (tanker, tipper, lambda rng, c, rgb: bus(rng, c, rgb, coach=True)),
    "railing": (guard_rail, mesh, planks),
    "pole": (ordered("pole", model="square"), traffic_light, column),
    "fork": (concrete_fork, plated_fork),
    "wall": (block, jersey, pillared),
    "vegetation": (bush, conifer, birch),
    "debris": (ordered("tyre", model="standing", length_m=between(0.6, 0.8)), barrel, sack),
}
LATER: dict[str, tuple[Family, ...]] = {
    "person": (
        with_parcel,
        with_hand_truck,
        with_basket_cart,
        in_wheelchair,
        sitting,
        couple,
        with_dog,
        with_pole_over_shoulder,
    ),
    "bicycle": (racer, tandem, with_trailer, with_child_behind, parked_bicycles, laden_front, upright_rider),
    "car": (*(drawn_car(s) for s in (LOW, JEEP, TALL, STRETCHED)), any_car, any_car, with_roof_load, panel_van),
    "truck": (with_caravan, refuse_truck, mixer, curtain_truck, timber_truck, digger),
    "railing": (crowd_barrier, cables, panes, double_rail, rails_of_any_kind),
    "pole": (bollard_lamp, signal_arm, timber_pole),
    "fork": (any_fork,) * 6,
    "wall": (container, panelled, rough, kiosk, low_wall),
    "vegetation": (poplar, thicket, grasses, acacia),
    "debris": (dustbin, heap, chair, any_box, stacked),
}
SEEN = {kind: families + MORE[kind] for kind, families in SEEN.items()}
BOTH = {kind: families + LATER[kind] for kind, families in SEEN.items()}
FIRST_LATER = 1760
"""Training streets from this seed on draw from `LATER`, those before it from `SEEN`."""
FIRST_VARIED = 2500
"""Those from this seed on draw from both; no two things have the same proportions, and not all plants are green."""
FIRST_ALONE = 3120
"""From this seed on there is one thing in the middle of each street with free road on both sides, a fork or another."""
ALONE = {"car": 0.4, "truck": 0.2, "bicycle": 0.15, "person": 0.1, "debris": 0.05, "pole": 0.05, "railing": 0.05}
STRETCH, MOST_STRETCH = 0.12, 0.3
"""Natural logarithm of how much longer, wider and higher a thing is than its family's: scatter and most."""
AUTUMN: tuple[Rgb, ...] = ((196, 150, 40), (176, 92, 30), (150, 48, 34), (126, 92, 58), (148, 130, 92), (120, 70, 92))
IN_AUTUMN = 0.4
"""Colours of leaves that are not green, and how many plants have one of them."""
UNSEEN: dict[str, tuple[Family, ...]] = {
    "person": (with_pram, with_board),
    "bicycle": (in_poncho, folding_bicycle),
    "car": (drawn_car(MICRO), drawn_car(ESTATE), post_van),
    "truck": (flatbed, semitrailer),
    "railing": (lattice, site_fence),
    "pole": (two_plates, mast),
    "fork": (attenuator_fork, planted_fork),
    "wall": (gabions, shed),
    "vegetation": (clipped_balls, willow),
    "debris": (pallets, case),
}
"""Families of shapes by class."""


@dataclass(frozen=True)
class Street:
    """A scene, the rig before it, and what each of its numbers is."""

    scene: Scene
    rig: StereoRig
    classes: dict[int, str]


def rigs(rng: Rng) -> tuple[StereoRig, float]:
    """Draw a rig and its height: a wide one as on research cars, or a small one."""
    if rng.random() < 0.5:
        size, f_px, baseline, high = (1242, 375), rng.uniform(690, 760), rng.uniform(0.45, 0.6), rng.uniform(1.5, 1.75)
        cv = rng.uniform(165, 190)
    else:
        size, f_px, baseline, high = (1120, 512), rng.uniform(750, 1000), rng.uniform(0.16, 0.35), rng.uniform(1.2, 1.6)
        cv = rng.uniform(225, 260)
    camera = Camera(size, f_px, f_px, size[0] / 2 + rng.uniform(-15, 15), cv)
    return StereoRig(camera, camera, pose(np.eye(3), [baseline, 0, 0])), high


def turned(kind: str, rng: Rng) -> float:
    """Draw which way a thing of this class faces, degrees."""
    if kind == "fork":
        return float(rng.normal(0, 4))
    if kind in ("car", "truck", "bicycle"):
        return float(
            rng.choice((0, 180, 90, -90), p=(0.4, 0.35, 0.125, 0.125))
            + rng.normal(0, 8)
            + (rng.random() < 0.2) * rng.uniform(-60, 60)
        )
    if kind == "railing":
        return float(rng.choice((0, 90), p=(0.65, 0.35)) + rng.normal(0, 12))
    return float(rng.uniform(0, 360))


def drawn(families: tuple[Family, ...], rng: Rng) -> Thing:
    """Draw a thing of some families; its colour is a name of `BODY`, its shade near that name's."""
    color = str(rng.choice(BODY))
    rgb = tuple(int(np.clip(c * rng.uniform(0.9, 1.1), 0, 255)) for c in COLORS[color])
    return families[rng.integers(len(families))](rng, color, rgb)  # type: ignore[arg-type]


def varied(thing: Thing, rng: Rng) -> Thing:
    """Return the thing stretched, each way by itself; a plant may have lost its green."""
    factor = np.exp(np.clip(rng.normal(0, STRETCH, 3), -MOST_STRETCH, MOST_STRETCH))
    leaves = AUTUMN[rng.integers(len(AUTUMN))] if rng.random() < IN_AUTUMN and thing.type == "vegetation" else None
    return replace(thing, parts=tuple(stretched(part, factor, leaves) for part in thing.parts))


def stretched(part: Part, factor: Floats, leaves: Rgb | None) -> Part:
    """Return a part so many times as long; what is green of it has the colour of these leaves, if there are any."""
    R = part.T_thing_part[:3, :3]
    along = np.linalg.norm(factor[:, None] * R, axis=0)
    if part.shape not in ("box", "ellipsoid"):
        along[:2] = along[:2].mean()
    red, green, blue = part.rgb
    rgb = shaded(leaves, green / leaves[1]) if leaves and green > max(red, blue) else part.rgb
    return replace(part, T_thing_part=pose(R, factor * part.T_thing_part[:3, 3]), half_m=along * part.half_m, rgb=rgb)


def street(seed: int, unseen: bool, shadow: bool = False) -> Street:
    """Return a street with about nine things, none through another; in the `shadow` of a high wall, if wanted."""
    rng = np.random.default_rng([seed, 41, unseen])
    varies = not unseen and seed >= FIRST_VARIED
    families = UNSEEN if unseen else BOTH if varies else LATER if seed >= FIRST_LATER else SEEN
    road = Road(
        -rng.uniform(5, 10),
        rng.uniform(5, 10),
        (Line(-3.5), Line(3.5), Line(0, gap_m=4.5)),
        contrast=rng.uniform(0.08, 0.2),
    )
    rig, high = rigs(rng)
    reach = 0.42 * rig.left.size_px[0] / rig.left.fx_px
    kinds = list(rng.permutation(list(SEEN)))
    kinds += list(rng.choice(("person", "bicycle", "pole", "car", "debris", "railing"), 5))
    alone = "fork"
    if rng.random() < 0.55:
        kinds.remove("fork")
        alone = rng.choice(list(ALONE), p=list(ALONE.values())) if varies and seed >= FIRST_ALONE else ""
    if alone:
        kinds.insert(0, kinds.pop(kinds.index(alone)))
    kept: list[tuple[float, float, float, float]] = []
    things, classes = [], {}
    for place, kind in enumerate(kinds):
        is_alone = bool(alone) and place == 0
        thing = drawn(families[kind], rng)
        thing = varied(thing, rng) if varies else thing
        for _ in range(12):
            ahead = rng.uniform(5, 38) if kind != "wall" else rng.uniform(12, 40)
            left = rng.uniform(-2.5, 2.5) if is_alone else rng.uniform(-1, 1) * min(reach * ahead, 11)
            placed = on_road(thing, road, ahead, left, np.radians(turned(kind, rng)))
            (x0, y0, _), (x1, y1, _) = placed.bounds_m(placed.T_world_thing)
            beside = 2.5 if is_alone else 0.5
            if all(x1 + 0.6 < a or x0 - 0.6 > b or y1 + beside < c or y0 - beside > d for a, c, b, d in kept):
                kept.append((x0, y0 - beside + 0.5, x1, y1 + beside - 0.5))
                things.append(replace(placed, id=len(things) + 1))
                classes[len(things)] = kind
                break
    sun = to_sun(rng.uniform(0, 360), rng.uniform(25, 60))
    if shadow:  # a wall beside the road, higher than the sun
        sun = to_sun(90, 35)
        shade = box((120, 1, 22), (30, 0, 11), (150, 140, 130), 0.15)
        things.append(on_road(Thing(0, "screen", "grey", (shade,)), road, -30, 15.5))
    camera = camera_pose(high, np.radians(rng.uniform(-0.5, 1.5)), np.radians(rng.normal(0, 0.3)))
    return Street(Scene(tuple(things), road, camera, sun, seed), rig, classes)


def picture(seed: int, unseen: bool, shadow: bool, folder: Path) -> dict[str, Any]:
    """Return a street's pair, what is true in it, and its rig; from a file of `folder` if it is there."""
    path = folder / f"{'unseen' if unseen else 'seen'}{'_shadow' * shadow}_{seed}.npz"
    if not path.exists():
        made = street(seed, unseen, shadow)
        seen = photograph(made.scene, made.rig, CONDITIONS["day"], quality=Quality(1, 4), seed=seed)  # type: ignore[arg-type]
        true = [asdict(thing) | {"class": made.classes[thing.id]} for thing in seen.objects]
        camera = made.rig.left
        np.savez_compressed(
            path,
            left=seen.pair.left,
            right=seen.pair.right,
            ids=seen.ids.astype(np.uint8),
            depth_cm=np.clip(np.nan_to_num(100 * seen.depth_m, posinf=65535), 0, 65535).astype(np.uint16),
            rig=np.array([*camera.size_px, camera.fx_px, camera.cx_px, camera.cy_px, made.rig.baseline_m]),
            true=json.dumps(true, default=list),
        )
    drawn = dict(np.load(path))
    width, height, f_px, cx_px, cy_px, baseline_m = drawn["rig"].tolist()
    camera = Camera((int(width), int(height)), f_px, f_px, cx_px, cy_px)
    rig = StereoRig(camera, camera, pose(np.eye(3), [baseline_m, 0, 0]))
    return drawn | {"rig": rig, "true": json.loads(str(drawn["true"]))}
