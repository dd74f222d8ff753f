"""Train the model of types: `python benchmarks/accuracy/train_recognition.py [--streets N] [--pictures DIR]`.

Simulated streets of `recognition_world.py` (seeds from `FIRST` on, families `SEEN`) go through the `cells` detector.
Each region is one example: its class is that of the thing most of its cells see, "unknown" where no thing has
`MOST` of them. Mirror images and disturbed copies count too. Every fifth street is kept from training; temperature (so
that probabilities are as often right as they say) is fitted on these. The result replaces
`src/roadblock/stages/recognize/model.json`.
"""

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from recognition_world import picture
from scipy.optimize import minimize, minimize_scalar

from roadblock.config import Settings
from roadblock.detectors import make_detector
from roadblock.kernels.reference.recognize import CELLS_HIGH, CELLS_WIDE, COLUMNS, LOOKS, OWN, TURNS
from roadblock.stages.recognize.survey import INPUTS, survey
from roadblock.stages.recognize.types import CLASSES, LIMIT, MODEL, TypeModel
from roadblock.stages.rectify import plan_rectification, rectify
from roadblock.values.frame import StereoPair
from roadblock.values.scene import Region

Floats = NDArray[np.float64]
FIRST, STREETS = 1000, 760
MOST, LEAST_SEEN = 0.6, 0.2
"""A region is a thing if that share of its cells on any is on this one, and that share of all its cells on one."""
HIDDEN, DECAY, STEPS, SEED = 48, 1e-3, 250, 0
FORKS = 0.5
"""Roads fork less often than these streets do."""
NOISE, LOOKS_NOISE = 0.2, 0.7
"""A third copy of each example differs from it so much, in standard deviations: real things look otherwise."""
DIGITS = 3


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


def examples(seeds: range, folder: Path) -> tuple[Floats, NDArray[np.int64], NDArray[np.int64]]:
    """Return inputs, classes and seeds of all regions."""
    inputs, classes, streets = [], [], []
    for seed in seeds:
        shot = picture(seed, False, seed % 8 == 5, folder)
        rig = shot["rig"]
        pair = rectify(StereoPair(shot["left"], shot["right"]), plan_rectification(rig), rig.left.size_px)
        found = make_detector(Settings())(pair)
        if found.regions:
            inputs.append(survey(pair, found).inputs)
            classes += [CLASSES.index(whose(region, shot)[0]) for region in found.regions]
            streets += [seed] * len(found.regions)
    return np.concatenate(inputs), np.array(classes), np.array(streets)


def mirrored() -> NDArray[np.int64]:
    """Return where each input comes from in the mirror image."""
    places = np.arange(INPUTS)
    for first in (16, 16 + COLUMNS):
        places[first : first + COLUMNS] = places[first : first + COLUMNS][::-1]
    beside = OWN + LOOKS
    for first in (OWN, beside + 4 + 5):
        cells = places[first : first + LOOKS - 1].reshape(CELLS_HIGH, CELLS_WIDE, TURNS)
        cells[:] = cells[:, ::-1][:, :, [0, 3, 2, 1]].copy()
    places[beside : beside + 4] = [beside + 2, beside + 3, beside, beside + 1]
    return places


def disturbed(inputs: Floats, rng: np.random.Generator) -> Floats:
    """Return the examples with noise."""
    sigma = np.full(INPUTS, NOISE)
    for first in (OWN, OWN + LOOKS + 4 + 5):
        sigma[first : first + LOOKS] = LOOKS_NOISE
    return inputs + sigma * inputs.std(0) * rng.standard_normal(inputs.shape)


def unpacked(weights: Floats) -> tuple[Floats, Floats, Floats, Floats]:
    """Return the layers that one vector holds."""
    ends = np.cumsum([INPUTS * HIDDEN, HIDDEN, HIDDEN * len(CLASSES)])
    a, b, c, d = np.split(weights, ends)
    return a.reshape(INPUTS, HIDDEN), b, c.reshape(HIDDEN, len(CLASSES)), d


def fit(inputs: Floats, classes: NDArray[np.int64]) -> TypeModel:
    """Return the model that explains the examples best: cross entropy, rare classes weigh more, weights decay."""
    mean, spread = inputs.mean(0), inputs.std(0) + 0.01
    x = np.clip((inputs - mean) / spread, -LIMIT, LIMIT)
    weight = 1 / np.sqrt(np.bincount(classes, minlength=len(CLASSES)) + 1)
    weight[CLASSES.index("fork")] *= FORKS
    weight = weight[classes] / weight[classes].sum()
    target = np.eye(len(CLASSES))[classes]

    def loss(weights: Floats) -> tuple[float, Floats]:
        hidden, hidden_bias, output, output_bias = unpacked(weights)
        active = np.tanh(x @ hidden + hidden_bias)
        scores = active @ output + output_bias
        scores -= scores.max(1, keepdims=True)
        odds = np.exp(scores)
        odds /= odds.sum(1, keepdims=True)
        cost = -(weight * np.log(odds[np.arange(len(x)), classes] + 1e-12)).sum()
        cost += DECAY * ((hidden**2).sum() + (output**2).sum())
        back = (odds - target) * weight[:, None]
        inner = back @ output.T * (1 - active**2)
        parts = (x.T @ inner + 2 * DECAY * hidden, inner.sum(0), active.T @ back + 2 * DECAY * output, back.sum(0))
        return float(cost), np.concatenate([part.ravel() for part in parts])

    rng = np.random.default_rng(SEED)
    start = np.concatenate(
        [
            rng.normal(0, INPUTS**-0.5, INPUTS * HIDDEN),
            np.zeros(HIDDEN),
            rng.normal(0, HIDDEN**-0.5, HIDDEN * len(CLASSES)),
            np.zeros(len(CLASSES)),
        ]
    )
    best = minimize(loss, start, jac=True, method="L-BFGS-B", options={"maxiter": STEPS}).x
    return TypeModel(mean, spread, *unpacked(best))


def tempered(model: TypeModel, inputs: Floats, classes: NDArray[np.int64]) -> float:
    """Return the temperature under which these examples are most probable."""

    def cost(temperature: float) -> float:
        odds = TypeModel(**(vars(model) | {"temperature": temperature})).probabilities(inputs)
        return -float(np.log(odds[np.arange(len(inputs)), classes] + 1e-12).mean())

    return float(minimize_scalar(cost, bounds=(0.3, 5), method="bounded").x)


def main() -> None:
    """Train, fit the temperature, write."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--streets", type=int, default=STREETS)
    parser.add_argument("--pictures", type=Path, default=Path("pictures"))
    options = parser.parse_args()
    options.pictures.mkdir(exist_ok=True)
    inputs, classes, streets = examples(range(FIRST, FIRST + options.streets), options.pictures)
    held = streets % 5 == 4
    own, kinds = inputs[~held], classes[~held]
    copies = (own, own[:, mirrored()], disturbed(own, np.random.default_rng(SEED)))
    model = fit(np.concatenate(copies), np.tile(kinds, len(copies)))
    temperature = tempered(model, inputs[held], classes[held])
    right = model.probabilities(inputs[held]).argmax(1) == classes[held]
    print(f"{len(own)} examples, {held.sum()} held out: {right.mean():.3f} right, temperature {temperature:.2f}")
    record = {
        "classes": list(CLASSES),
        "recipe": f"benchmarks/accuracy/train_recognition.py --streets {options.streets}: seeds from {FIRST}, "
        f"{len(own)} regions, their mirror images and disturbed ones; hidden {HIDDEN}, decay {DECAY}, seed {SEED}; "
        f"temperature from {int(held.sum())} regions of every fifth street, of which {right.mean():.3f} were right",
        "temperature": round(temperature, DIGITS),
        **{name: np.round(getattr(model, name), DIGITS).tolist() for name in vars(model) if name != "temperature"},
    }
    MODEL.write_text(json.dumps(record) + "\n", "utf-8")


if __name__ == "__main__":
    main()
