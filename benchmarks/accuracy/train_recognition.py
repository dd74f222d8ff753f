"""Train the model of types: `python benchmarks/accuracy/train_recognition.py [--streets N] [--pictures DIR]`.

Simulated streets of `recognition_world.py` (seeds from `FIRST` on, families `SEEN`, then `LATER`, then both, varied) go
through the `cells` detector. Each region is one example: its class is that of the thing most of its cells see,
"unknown" where no thing has `MOST` of them. Of a fork the nearest region, its nose, weighs more than its flanks, which
look like the railings and walls they are. Mirror images count too. Several small networks are trained from different
beginnings and put side by side as one: their mean is surer than each. Every fifth street is kept from training;
temperature (so that probabilities are as often right as they say) is fitted on these. The result replaces
`src/roadblock/stages/recognize/model.json`.
"""

import argparse
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from recognition_world import picture
from scipy.optimize import minimize_scalar

from roadblock.config import Settings
from roadblock.detectors import make_detector
from roadblock.kernels.reference.judge import LIMIT
from roadblock.kernels.reference.recognize import (
    ASIDE_M,
    BACK,
    CELLS_HIGH,
    CELLS_WIDE,
    COLUMNS,
    GRID,
    LAYERS,
    LOOKS,
    OWN,
    TOGETHER,
    TOPS,
    TURNS,
)
from roadblock.stages.recognize.survey import INPUTS, survey
from roadblock.stages.recognize.types import CLASSES, MODEL, TypeModel
from roadblock.stages.rectify import plan_rectification, rectify
from roadblock.values.frame import StereoPair
from roadblock.values.scene import Region

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Slopes = list[Singles]
FIRST, STREETS = 1000, 2900
MOST, LEAST_SEEN = 0.6, 0.2
"""A region is a thing if that share of its cells on any is on this one, and that share of all its cells on one."""
NETWORKS, HIDDEN, SEED = 2, 128, 0
EPOCHS, BATCH, RATE, WARM_UP, DECAY = 150, 256, 2e-3, 200, 1e-3
"""Adam: passes, examples and rate of a step, steps until the full rate, which falls to 0 by a cosine; of weights."""
NOSE, FLANK = 1.5, 0.3
"""What the nearest region of a fork weighs, and what the others do."""
NOISE, LOOKS_NOISE, DROPPED_INPUTS, DROPPED = 0.3, 0.75, 0.1, 0.3
"""Each time an example is looked at it differs by so much, in standard deviations, and such shares of its inputs and of
the hidden units are missing: real things look otherwise."""
DIGITS = 3
PARTS = ("mean", "spread", "hidden", "hidden_bias", "output", "output_bias")


def whose(region: Region, shot: dict[str, Any]) -> tuple[str, int]:
    """Return the class of what a region is and its number in the truth; unknown and 0 where it is no one thing."""
    u, v = region.surface_uvd_px[:, 0].astype(int), region.surface_uvd_px[:, 1].astype(int)
    counts = np.bincount(shot["ids"][v, u], minlength=256)
    on_things = counts[1:].sum()
    number = int(counts[1:].argmax()) + 1
    classes = {thing["id"]: thing["class"] for thing in shot["true"]}
    if number not in classes or counts[number] < MOST * on_things or on_things < LEAST_SEEN * counts.sum():
        return "unknown", 0
    return classes[number], number


def examples(seeds: range, folder: Path) -> tuple[Floats, NDArray[np.int64], Floats, NDArray[np.int64]]:
    """Return inputs, classes, weights and seeds of all regions."""
    inputs, classes, weights, streets = [], [], [], []
    for seed in seeds:
        shot = picture(seed, False, seed % 8 == 5, folder)
        rig = shot["rig"]
        pair = rectify(StereoPair(shot["left"], shot["right"]), plan_rectification(rig), rig.left.size_px)
        found = make_detector(Settings())(pair)
        if not found.regions:
            continue
        measured, kinds = survey(pair, found).inputs, [whose(region, shot)[0] for region in found.regions]
        flanks = [i for i, kind in enumerate(kinds) if kind == "fork"]
        weight = np.ones(len(kinds))
        weight[flanks] = FLANK
        if flanks:
            weight[min(flanks, key=lambda i: measured[i, 0])] = NOSE  # the nearest one: streets have one fork at most
        inputs.append(measured)
        weights.append(weight)
        classes += [CLASSES.index(kind) for kind in kinds]
        streets += [seed] * len(kinds)
    return np.concatenate(inputs), np.array(classes), np.concatenate(weights), np.array(streets)


def mirrored() -> NDArray[np.int64]:
    """Return where each input comes from in the mirror image."""
    places = np.arange(INPUTS)
    for first in (TOPS, BACK):
        places[first : first + COLUMNS] = places[first : first + COLUMNS][::-1]
    grid = places[GRID:BACK].reshape(LAYERS, COLUMNS)
    grid[:] = grid[:, ::-1].copy()
    for first in (OWN, TOGETHER + 5):
        cells = places[first : first + LOOKS - 1].reshape(CELLS_HIGH, CELLS_WIDE, TURNS)
        cells[:] = cells[:, ::-1][:, :, [0, 3, 2, 1]].copy()
    for first, count in ((OWN + LOOKS, 2), (OWN + LOOKS + 4, len(ASIDE_M))):
        sides = places[first : first + 2 * count].reshape(2, count)
        sides[:] = sides[::-1].copy()
    return places


def fit(inputs: Floats, classes: NDArray[np.int64], weights: Floats, seed: int) -> TypeModel:
    """Return the model that explains the examples best: cross entropy, rare classes weigh more. About two minutes."""
    rng = np.random.default_rng(seed)
    mean, spread = inputs.mean(0), inputs.std(0) + 0.01
    both = np.stack([inputs, inputs[:, mirrored()]], 1)
    both = np.clip((both - mean) / spread, -LIMIT, LIMIT).astype(np.float32)
    weight = weights / np.sqrt(np.bincount(classes, minlength=len(CLASSES)) + 1)[classes]
    weight = (weight / weight.mean()).astype(np.float32)
    target = np.eye(len(CLASSES), dtype=np.float32)[classes]
    noise = np.full(INPUTS, NOISE, np.float32)
    for first in (OWN, TOGETHER + 5):
        noise[first : first + LOOKS] = LOOKS_NOISE
    sizes = (INPUTS, HIDDEN), (HIDDEN, len(CLASSES))
    parts = [rng.normal(0, (2 / sizes[0][0]) ** 0.5, sizes[0]), np.zeros(HIDDEN)]
    parts += [rng.normal(0, 0.3 * HIDDEN**-0.5, sizes[1]), np.zeros(len(CLASSES))]
    parts = [part.astype(np.float32) for part in parts]
    drifts, squares = ([np.zeros_like(part) for part in parts] for _ in range(2))
    batches = len(classes) // BATCH
    steps = EPOCHS * batches
    for step in range(1, steps + 1):
        first = (step - 1) % batches * BATCH
        if first == 0:
            order = rng.permutation(len(classes))
        some = order[first : first + BATCH]
        x = both[some, rng.integers(0, 2, BATCH)] + noise * rng.standard_normal((BATCH, INPUTS), np.float32)
        slopes = descent(x, target[some], weight[some, None] / BATCH, parts, rng)
        rate = RATE * min(1.0, step / WARM_UP) * 0.5 * (1 + np.cos(np.pi * step / steps))
        for part, slope, drift, square in zip(parts, slopes, drifts, squares, strict=True):
            drift += 0.1 * (slope - drift)
            square += 0.001 * (slope**2 - square)
            part -= rate * drift / (1 - 0.9**step) / (np.sqrt(square / (1 - 0.999**step)) + 1e-8)
    return TypeModel(mean, spread, *(part.astype(float) for part in parts))


def descent(x: Singles, target: Singles, weight: Singles, parts: list[Singles], rng: np.random.Generator) -> Slopes:
    """Return how the cost of some examples grows with each weight; other inputs and units are missing each time."""
    hidden, hidden_bias, output, output_bias = parts
    x = x * (rng.random(x.shape, np.float32) > DROPPED_INPUTS)
    kept = (rng.random((len(x), HIDDEN), np.float32) > DROPPED) / np.float32(1 - DROPPED)
    active = np.maximum(x @ hidden + hidden_bias, 0) * kept
    scores = active @ output + output_bias
    odds = np.exp(scores - scores.max(1, keepdims=True))
    back = (odds / odds.sum(1, keepdims=True) - target) * weight
    inner = back @ output.T * kept * (active > 0)
    return [x.T @ inner + DECAY * hidden, inner.sum(0), active.T @ back + DECAY * output, back.sum(0)]


def side_by_side(models: list[TypeModel]) -> TypeModel:
    """Return one model whose scores are the mean of theirs."""
    return TypeModel(
        models[0].mean,
        models[0].spread,
        np.concatenate([model.hidden for model in models], axis=1),
        np.concatenate([model.hidden_bias for model in models]),
        np.concatenate([model.output for model in models]) / len(models),
        np.mean([model.output_bias for model in models], axis=0),
    )


def tempered(model: TypeModel, inputs: Floats, classes: NDArray[np.int64]) -> float:
    """Return the temperature under which these examples are most probable."""

    def cost(temperature: float) -> float:
        odds = replace(model, temperature=temperature).probabilities(inputs)
        return -float(np.log(odds[np.arange(len(inputs)), classes] + 1e-12).mean())

    return float(minimize_scalar(cost, bounds=(0.3, 5), method="bounded").x)


def main() -> None:
    """Train, fit the temperature, write."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--streets", type=int, default=STREETS)
    parser.add_argument("--pictures", type=Path, default=Path("pictures"))
    options = parser.parse_args()
    options.pictures.mkdir(exist_ok=True)
    inputs, classes, weights, streets = examples(range(FIRST, FIRST + options.streets), options.pictures)
    held = streets % 5 == 4
    own = inputs[~held], classes[~held], weights[~held]
    model = side_by_side([fit(*own, SEED + k) for k in range(NETWORKS)])
    temperature = tempered(model, inputs[held], classes[held])
    right = np.mean(model.probabilities(inputs[held]).argmax(1) == classes[held])
    print(f"{len(own[0])} examples, {held.sum()} held out: {right:.3f} right, temperature {temperature:.2f}")
    record = {
        "classes": list(CLASSES),
        "recipe": f"benchmarks/accuracy/train_recognition.py --streets {options.streets}: seeds from {FIRST}, "
        f"{len(own[0])} regions and their mirror images, disturbed; {NETWORKS} networks of {HIDDEN}, {EPOCHS} epochs, "
        f"seeds from {SEED}; temperature from {held.sum()} regions of every fifth street, of which {right:.3f} right",
        "temperature": round(temperature, DIGITS),
        **{name: np.round(getattr(model, name), DIGITS).tolist() for name in PARTS},
    }
    MODEL.write_text(json.dumps(record) + "\n", "utf-8")


if __name__ == "__main__":
    main()
