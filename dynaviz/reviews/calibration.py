"""The probability that the answer about a candidate is wrong, as measured."""

from __future__ import annotations

import math
from collections.abc import Mapping

FEATURES = (
    "passed", "passes", "hits", "frames", "ground", "mixed", "moved", "size", "height", "points",
)  # fmt: skip
WEIGHTS: dict[str, tuple[float, ...]] = {
    "kept": (-1.121, 0.766, 0.414, -2.08, -0.685, 0.0, 3.129, 1.463, -2.148, -0.069, 1.0),
    "removed": (-0.191, 0.181, -0.666, 0.705, 0.076, 1.783, 1.593, -1.334, 1.092, 0.046, -0.441),
}
"""Fitted by ``benchmarks/review.py --fit``: a constant, then one for each feature."""


def probability(answered: str, features: Mapping[str, float]) -> float:
    """The probability that the answer about a candidate is wrong.

    Args:
        answered: ``kept`` or ``removed``.
        features: by the names in ``FEATURES``.
    """
    constant, *weights = WEIGHTS[answered]
    total = sum(weight * features[name] for name, weight in zip(FEATURES, weights, strict=True))
    return 1 / (1 + math.exp(-constant - total))
