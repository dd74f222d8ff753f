"""Persons: standing, or walking through the phases of a stride."""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from roadblock.geometry.pose import pose, rotation_from_rotvec
from roadblock.sim.solids import Part, Rgb, Thing, capsule, carried, ellipsoid, grounded, scaled
from roadblock.values.checks import FloatArray

ADULT_M = 1.75
"""Height the figure below is drawn for."""

HEAD_M = 0.25
"""Of it, what is head: a child's shrinks more slowly than its body."""

STRIDE_M = 1.4
"""Way of two steps of an adult."""

THIGH_M, SHANK_M = 0.40, 0.39

# One leg over a stride that begins when its heel touches down; degrees, forward and bent positive.
STRIDE_PHASE = (0.0, 0.12, 0.3, 0.5, 0.62, 0.74, 0.88, 1.0)
HIP_DEG = (24.0, 18.0, 2.0, -14.0, -2.0, 18.0, 27.0, 24.0)
KNEE_DEG = (6.0, 16.0, 6.0, 12.0, 40.0, 58.0, 20.0, 6.0)
TOE_DEG = (16.0, 0.0, 0.0, -22.0, -48.0, -24.0, 8.0, 16.0)


class Looks(NamedTuple):
    """What a person wears and is."""

    jacket: Rgb
    trousers: Rgb
    skin: Rgb = (214, 160, 130)
    hair: Rgb = (62, 44, 34)
    shoe: Rgb = (48, 42, 40)
    pack: Rgb | None = None


SKINS: tuple[Rgb, ...] = ((224, 176, 148), (214, 160, 130), (168, 116, 84), (106, 72, 54))
HAIRS: tuple[Rgb, ...] = ((32, 28, 26), (62, 44, 34), (148, 110, 66), (170, 168, 164))
PACKS: tuple[Rgb | None, ...] = (None, None, (60, 62, 74), (120, 40, 40))


def person(
    number: int,
    color: str,
    jacket: Rgb,
    trousers: Rgb,
    height_m: float = ADULT_M,
    *,
    stride: float | None = None,
    rng: np.random.Generator | None = None,
) -> Thing:
    """Return a person facing x.

    Parameters
    ----------
    number
        Its id.
    color
        Name of the clothes' colour.
    jacket, trousers
        sRGB 0..255.
    height_m
        Top of the head over the ground when standing, metres; a child's head is large for its body.
    stride
        Where in a stride it walks, 0..1 (0 = the left heel touches down, 0.5 = the right); None = it stands.
        In mid-stride a person is up to 4 % lower.
    rng
        Draws skin, hair and whether there is a backpack; None = the same looks always.
    """
    looks = Looks(jacket, trousers) if rng is None else _looks(jacket, trousers, rng)
    body = (height_m - HEAD_M * np.sqrt(height_m / ADULT_M)) / (ADULT_M - HEAD_M)

    def gait(gone_m: float) -> tuple[Part, ...]:
        phase = None if stride is None else stride + gone_m / (STRIDE_M * body)
        below = scaled([*trunk(looks), *_limbs(looks, phase)], body)
        neck = pose(np.eye(3), [0.0, 0.0, (ADULT_M - HEAD_M) * body])
        return grounded([*below, *carried(scaled(head(looks), np.sqrt(height_m / ADULT_M)), neck)])

    return Thing(number, "person", color, gait(0.0), gait=None if stride is None else gait)


def _looks(jacket: Rgb, trousers: Rgb, rng: np.random.Generator) -> Looks:
    skin, hair, pack = SKINS[rng.integers(4)], HAIRS[rng.integers(4)], PACKS[rng.integers(4)]
    return Looks(jacket, trousers, skin, hair, pack=pack)


def trunk(looks: Looks) -> list[Part]:
    """Return hips to shoulders of an adult, feet at z = 0."""
    pack = [] if looks.pack is None else [ellipsoid((0.10, 0.14, 0.21), (-0.15, 0, 1.2), looks.pack, 0.3)]
    return [
        ellipsoid((0.115, 0.165, 0.13), (0, 0, 0.92), looks.trousers, 0.2),
        ellipsoid((0.115, 0.160, 0.25), (0, 0, 1.12), looks.jacket, 0.25),
        ellipsoid((0.120, 0.185, 0.20), (0, 0, 1.28), looks.jacket, 0.25),
        capsule((0, -0.145, 1.405), (0, 0.145, 1.405), 0.062, looks.jacket, 0.25),
        *pack,
    ]


def head(looks: Looks) -> list[Part]:
    """Return neck and head of an adult, the chin at z = 0."""
    return [
        capsule((0, 0, -0.08), (0.01, 0, 0.04), 0.05, looks.skin, 0.08),
        ellipsoid((0.092, 0.073, 0.112), (0.015, 0, 0.13), looks.skin, 0.08),
        ellipsoid((0.098, 0.082, 0.095), (-0.015, 0, 0.155), looks.hair, 0.2),
    ]


def _limbs(looks: Looks, phase: float | None) -> list[Part]:
    parts = []
    for side, begin in ((1, 0.0), (-1, 0.5)):
        if phase is None:
            hip, knee, toe, arm = 0.0, 0.0, 0.0, 0.0
        else:
            at = (phase + begin) % 1.0
            hip, knee, toe = (float(np.interp(at, STRIDE_PHASE, deg)) for deg in (HIP_DEG, KNEE_DEG, TOE_DEG))
            arm = -20.0 * np.cos(2 * np.pi * at)
        parts += _leg(side, np.radians([hip, knee, toe]), looks) + _arm(side, np.radians(arm), looks)
    return parts


def _swung(angle_rad: float, length_m: float) -> FloatArray:
    """Return the way from a joint down a limb that is swung forward."""
    return length_m * np.array([np.sin(angle_rad), 0.0, -np.cos(angle_rad)])


def _leg(side: int, hip_knee_toe_rad: FloatArray, looks: Looks) -> list[Part]:
    thigh, bend, toe = hip_knee_toe_rad
    hip = np.array([0.0, side * 0.09, 0.88])
    knee = hip + _swung(thigh, THIGH_M) + (0, side * 0.01, 0)
    ankle = knee + _swung(thigh - bend, SHANK_M) + (0, side * 0.005, 0)
    return [*leg(hip, knee, ankle, looks), shoe(ankle, toe, looks)]


def leg(hip: ArrayLike, knee: ArrayLike, ankle: ArrayLike, looks: Looks) -> list[Part]:
    """Return a leg through its joints."""
    return [capsule(hip, knee, 0.068, looks.trousers, 0.2), capsule(knee, ankle, 0.05, looks.trousers, 0.2)]


def shoe(ankle: FloatArray, toe_rad: float, looks: Looks) -> Part:
    """Return the shoe at an ankle, its toe up by `toe_rad`."""
    T = pose(rotation_from_rotvec([0.0, -toe_rad, 0.0]), ankle)
    return carried([ellipsoid((0.13, 0.048, 0.045), (0.05, 0, -0.045), looks.shoe, 0.1)], T)[0]


def _arm(side: int, swing_rad: float, looks: Looks) -> list[Part]:
    shoulder = np.array([0.0, side * 0.19, 1.4])
    elbow = shoulder + _swung(swing_rad - 0.06, 0.27) + (0, side * 0.065, 0)
    wrist = elbow + _swung(swing_rad + 0.25 + 0.4 * max(swing_rad, 0), 0.25) + (0, side * 0.015, 0)
    return [*arm(shoulder, elbow, wrist, looks), hand(wrist + _swung(swing_rad + 0.2, 0.065), looks)]


def arm(shoulder: ArrayLike, elbow: ArrayLike, wrist: ArrayLike, looks: Looks) -> list[Part]:
    """Return an arm through its joints."""
    return [capsule(shoulder, elbow, 0.047, looks.jacket, 0.25), capsule(elbow, wrist, 0.038, looks.jacket, 0.25)]


def hand(at: ArrayLike, looks: Looks) -> Part:
    """Return a hanging hand."""
    return ellipsoid((0.035, 0.025, 0.07), at, looks.skin, 0.08)
