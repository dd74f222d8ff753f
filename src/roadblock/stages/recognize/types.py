"""What a thing is: a small model of types, trained on our own simulated streets alone (docs/recognition.md)."""

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from roadblock.kernels.compiled.judge import judge_types
from roadblock.kernels.reference.recognize import INPUTS
from roadblock.values.checks import FloatArray

UNKNOWN = "unknown"
CLASSES = (
    "person",
    "bicycle",
    "car",
    "truck",
    "railing",
    "pole",
    "fork",
    "wall",
    "vegetation",
    "debris",
    UNKNOWN,
)
"""What the model tells apart; a bicycle may be ridden, a truck may be a bus, a car may be a van."""
MOVING = ("person", "bicycle", "car", "truck", UNKNOWN)
STANDS_STILL = 0.02
"""So often something else than `MOVING` seems to move."""
MODEL = Path(__file__).parent / "model.json"


@dataclass(frozen=True, eq=False)
class TypeModel:
    """One hidden layer between the inputs and the classes.

    Attributes
    ----------
    mean, spread
        (INPUTS,) of each input over the training set.
    hidden, hidden_bias
        (INPUTS, h) and (h,); what is negative becomes 0.
    output, output_bias
        (h, classes) and (classes,).
    temperature
        By which the outputs are divided, so that probabilities are as often right as they say.
    """

    mean: FloatArray
    spread: FloatArray
    hidden: FloatArray
    hidden_bias: FloatArray
    output: FloatArray
    output_bias: FloatArray
    temperature: float = 1.0

    @cached_property
    def _numbers(self) -> tuple[NDArray[np.float32], ...]:
        """What the kernel takes."""
        layers = self.mean, 1 / self.spread, self.hidden, self.hidden_bias
        ends = self.output / self.temperature, self.output_bias / self.temperature
        return tuple(np.ascontiguousarray(part, np.float32) for part in (*layers, *ends))

    def probabilities(self, inputs: FloatArray) -> FloatArray:
        """Return (n, classes) the probability of each class, given (n, INPUTS) what was measured."""
        odds = np.empty((len(inputs), len(self.output_bias)))
        mean, per_spread, hidden, hidden_bias, output, output_bias = self._numbers
        judge_types(inputs, mean, per_spread, hidden, hidden_bias, output, output_bias, odds)
        return odds


@cache
def shipped_model() -> TypeModel:
    """Return the model that came with the package."""
    text = json.loads(MODEL.read_text("utf-8"))
    names = ("mean", "spread", "hidden", "hidden_bias", "output", "output_bias")
    model = TypeModel(**{name: np.array(text[name], float) for name in names}, temperature=text["temperature"])
    assert text["classes"] == list(CLASSES), "model.json is of another version: train it again"  # noqa: S101
    assert model.hidden.shape[0] == INPUTS, "model.json is of another version: train it again"  # noqa: S101
    return model


def moving_odds(odds: Mapping[str, float]) -> dict[str, float]:
    """Return how probable each class is of what is seen to move: what stands still by nature hardly does."""
    weighed = {name: odds[name] * (1.0 if name in MOVING else STANDS_STILL) for name in odds}
    total = sum(weighed.values())
    return {name: weight / total for name, weight in weighed.items()}


def label(odds: Mapping[str, float], least: float) -> tuple[str, float]:
    """Return the most probable class and how probable it is; unknown and NaN if that is less than `least`."""
    known = list(odds.values())
    best = list(odds)[known.index(max(known))]
    return (UNKNOWN, math.nan) if best == UNKNOWN or odds[best] < least else (best, odds[best])
