"""Every type of thing by name: what can be said of it, and how it is built."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from difflib import get_close_matches
from typing import NamedTuple

import numpy as np

from roadblock.errors import ValueRefusedError
from roadblock.sim.solids import Rgb, Thing
from roadblock.sim.things.bikes import HEIGHT_M, bicycle, cyclist
from roadblock.sim.things.colors import COLORS
from roadblock.sim.things.people import person
from roadblock.sim.things.street import (
    SIGNS,
    carton,
    crate,
    fork,
    hedge,
    pole,
    railing,
    sign,
    stone,
    traffic_cone,
    tyre,
    wall,
)
from roadblock.sim.things.vehicles import CARS, car, truck, van

SIZE_RANGE_M = (0.02, 60.0)
"""What a length, width or height of a thing can be."""


@dataclass(frozen=True)
class Order:
    """What is wanted of a thing; "" or None = as is usual for its type.

    Attributes
    ----------
    type, model
        What it is, a key of `TYPES`, and which of its models.
    number
        Its id.
    color
        A key of `COLORS`.
    length_m, width_m, height_m
        Along, across and above its own axes.
    walking
        Whether a person walks (its stride is drawn) or stands.
    seed
        Of everything that is drawn.
    """

    type: str
    number: int
    model: str = ""
    color: str = ""
    length_m: float | None = None
    width_m: float | None = None
    height_m: float | None = None
    walking: bool = False
    seed: int = 0


class Kind(NamedTuple):
    """A type of thing.

    Its usual colour, its models (the first is the usual one), what else an order may say of it, how it is built, and
    the shade of its usual colour, if that is another than `COLORS` says.
    """

    color: str
    models: tuple[str, ...]
    takes: tuple[str, ...]
    build: Callable[[Order, Rgb, np.random.Generator], Thing]
    rgb: Rgb | None = None


def build(order: Order) -> Thing:
    """Return the thing that was ordered, at the world's origin.

    Raises
    ------
    ValueRefusedError
        If there is no such type, model or colour, the type does not come in a given size, or the size is none.
    """
    kind = TYPES[chosen("type", order.type, tuple(TYPES))]
    color = chosen("color", order.color or kind.color, tuple(COLORS))
    rgb = kind.rgb if kind.rgb and not order.color else COLORS[color]
    if order.model and not kind.models:
        raise ValueRefusedError(f"a {order.type} has no models, but got model {order.model!r:.40}")
    model = chosen("model", order.model or kind.models[0], kind.models) if kind.models else ""
    _check_sizes(order, kind)
    return kind.build(replace(order, color=color, model=model), rgb, np.random.default_rng(order.seed))


def _check_sizes(order: Order, kind: Kind) -> None:
    can = f"{' and '.join(kind.takes)} only" if kind.takes else "nothing"
    sizes = {"length_m": order.length_m, "width_m": order.width_m, "height_m": order.height_m}
    for name, size in sizes.items():
        if size is None:
            continue
        if name not in kind.takes:
            raise ValueRefusedError(f"a {order.type} takes no {name}: one can choose {can}")
        if not SIZE_RANGE_M[0] <= size <= SIZE_RANGE_M[1]:
            low, high = SIZE_RANGE_M
            raise ValueRefusedError(f"{name} of a {order.type} must lie in {low:g}..{high:g} m, but got {size:g}")
    if order.walking and "walking" not in kind.takes:
        raise ValueRefusedError(f"a {order.type} does not walk: one can choose {can}")


def chosen(what: str, name: str, known: tuple[str, ...]) -> str:
    """Return `name` if it is one of `known`.

    Raises
    ------
    ValueRefusedError
        If it is not; the nearest known one is named.
    """
    if name in known:
        return name
    near = get_close_matches(str(name), known, 1)
    hint = f"did you mean {near[0]}?" if near else "choose one of these"
    raise ValueRefusedError(f"{name!r:.40} is no known {what}; {hint} ({', '.join(known)})")


DARK: tuple[Rgb, ...] = ((44, 62, 122), (44, 44, 48), (96, 84, 66), (70, 74, 82))
"""Colours of trousers."""


def _person(order: Order, rgb: Rgb, rng: np.random.Generator) -> Thing:
    trousers = DARK[rng.integers(len(DARK))]
    tall = rng.uniform(1.0, 1.35) if order.model == "child" else rng.uniform(1.6, 1.9)
    stride = float(rng.random()) if order.walking else None
    return person(order.number, order.color, rgb, trousers, order.height_m or tall, stride=stride, rng=rng)


def _cyclist(order: Order, rgb: Rgb, rng: np.random.Generator) -> Thing:
    return cyclist(order.number, order.color, rgb, DARK[rng.integers(len(DARK))], rng=rng)


def _bicycle(order: Order, rgb: Rgb, rng: np.random.Generator) -> Thing:
    return bicycle(order.number, order.color, rgb, (order.height_m or HEIGHT_M) / HEIGHT_M, rng=rng)


def _car(order: Order, rgb: Rgb, rng: np.random.Generator) -> Thing:
    return car(order.number, order.color, rgb, order.model, rng=rng)


def _van(order: Order, rgb: Rgb, rng: np.random.Generator) -> Thing:
    return van(order.number, order.color, rgb, rng=rng)


def _truck(order: Order, rgb: Rgb, rng: np.random.Generator) -> Thing:
    return truck(order.number, order.color, rgb, rng=rng)


def _railing(order: Order, rgb: Rgb, _rng: np.random.Generator) -> Thing:
    bars = order.model == "bars"
    tall = order.height_m or (1.0 if bars else 0.75)
    return railing(order.number, order.color, rgb, order.length_m or 6.0, tall, bars=bars)


def _fork(order: Order, rgb: Rgb, _rng: np.random.Generator) -> Thing:
    return fork(order.number, order.color, rgb, order.length_m or 10.0, order.height_m or 1.15)


def _pole(order: Order, rgb: Rgb, rng: np.random.Generator) -> Thing:
    if order.model == "post":
        return pole(order.number, order.color, rgb, order.height_m or rng.uniform(3, 6))
    return sign(order.number, order.color, rgb, order.model, order.height_m or 2.6)


def _wall(order: Order, rgb: Rgb, rng: np.random.Generator) -> Thing:
    return wall(order.number, order.color, rgb, _size(order, (0.3, 4.0, 1.6)), rng=rng)


def _hedge(order: Order, rgb: Rgb, rng: np.random.Generator) -> Thing:
    return hedge(order.number, order.color, rgb, _size(order, (1.0, 4.0, 1.4)), rng=rng)


def _cone(order: Order, rgb: Rgb, _rng: np.random.Generator) -> Thing:
    return traffic_cone(order.number, order.color, rgb, order.height_m or 0.75)


def _tyre(order: Order, rgb: Rgb, rng: np.random.Generator) -> Thing:
    radius = (order.length_m or rng.uniform(0.58, 0.7)) / 2
    return tyre(order.number, order.color, rgb, radius, lying=order.model == "lying")


def _box(order: Order, rgb: Rgb, rng: np.random.Generator) -> Thing:
    length, width, height = rng.uniform(0.12, 0.3, 3)
    make = crate if order.model == "crate" else carton
    return make(order.number, order.color, rgb, _size(order, (length, width, height)))


def _stone(order: Order, rgb: Rgb, rng: np.random.Generator) -> Thing:
    return stone(order.number, order.color, rgb, order.length_m or rng.uniform(0.05, 0.3), rng=rng)


def _size(order: Order, usual: tuple[float, float, float]) -> tuple[float, float, float]:
    return order.length_m or usual[0], order.width_m or usual[1], order.height_m or usual[2]


_ALL = ("length_m", "width_m", "height_m")
TYPES: dict[str, Kind] = {
    "person": Kind("blue", ("adult", "child"), ("height_m", "walking"), _person),
    "cyclist": Kind("orange", (), (), _cyclist),
    "bicycle": Kind("red", (), ("height_m",), _bicycle),
    "car": Kind("silver", ("medium", *(name for name in CARS if name != "medium")), (), _car),
    "van": Kind("white", (), (), _van),
    "truck": Kind("blue", (), (), _truck),
    "railing": Kind("silver", ("bars", "beams"), ("length_m", "height_m"), _railing),
    "fork": Kind("yellow", (), ("length_m", "height_m"), _fork),
    "pole": Kind("grey", ("post", *SIGNS), ("height_m",), _pole),
    "wall": Kind("brown", (), _ALL, _wall),
    "hedge": Kind("green", (), _ALL, _hedge, (60, 98, 44)),
    "cone": Kind("orange", (), ("height_m",), _cone),
    "tyre": Kind("black", ("lying", "standing"), ("length_m",), _tyre),
    "box": Kind("brown", ("carton", "crate"), _ALL, _box, (170, 130, 88)),
    "stone": Kind("grey", (), ("length_m",), _stone),
}
"""Everything that can be ordered."""
