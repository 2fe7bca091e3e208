"""How suspicious a cluster of removed points looks when there is no ground truth, and why."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dynaviz.arrays import I32
from dynaviz.scores.sections import RemovedCluster
from dynaviz_eval.attribution import extent, shape, when_and_where
from dynaviz_eval.behaviour import BRIEF, WINDOW, shift, standing

# metres in one frame: from the length of a car to more than that of a truck or bus
LARGE = (
    5.0,
    15.0,
)
LASTING = (WINDOW, 5 * WINDOW)  # frames at one place: from a second to what few movers stand
MOVED = 2.0  # metres in a window, as far as a walker gets: the cluster is a mover
CLEAR = 0.25  # a sign as strong as this is stated
MOVER = 0.2  # what is left of the suspicion of a cluster that moved

MOVING = "moving"  # how the name of a cluster that moved begins
DOUBTFUL = 0.3  # of the whole suspicion: a cluster with more is called suspicious

# Shares of the whole suspicion. Ground outweighs any other sign: no road user is that low.
WEIGHTS = {"ground": 0.4, "level": 0.3, "large": 0.2, "lasting": 0.2, "kept": 0.15, "brief": 0.05}


def signs(case: np.void, rows: NDArray[np.void], visits: I32) -> dict[str, float]:
    """The signs of a removed static surface, each from 0 to 1, by the names in ``WEIGHTS``.

    Args:
        case: the cluster, a row of ``summed``; ``touching`` counts points next to points that were
            kept.
        rows: its rows, in the order of frames.
        visits: (K, 3) first frame, last frame and number of frames in which each of its cells was
            hit.
    """
    size = np.median(rows["high"] - rows["low"], axis=0)
    points = float(case["points"])
    ground = float(case["ground"] / case["points"])
    frames = float(np.count_nonzero(standing(rows)))
    return {
        "ground": ground,
        "level": float(ground < 0.5 and shape("false_positive", case) == "level surface"),
        "large": _between(float(size[:2].max()), *LARGE),
        "lasting": _between(frames, *LASTING),
        "kept": float(case["touching"]) / points,
        "brief": float(len(visits) > 0 and np.median(visits[:, 2]) <= BRIEF),
    }


def moved(rows: NDArray[np.void]) -> bool:
    """Whether a cluster moved by more than ``MOVED`` within a window, as movers do."""
    ends = np.searchsorted(rows["frame"], rows["frame"] + WINDOW)
    ends = np.minimum(ends, len(rows) - 1)
    ways = [shift(rows[i], rows[end]) for i, end in enumerate(ends.tolist()) if end > i]
    return bool(len(ways) and np.median(ways) > MOVED)


def suspicion(case: np.void, rows: NDArray[np.void], visits: I32) -> tuple[float, tuple[str, ...]]:
    """From 0 (looks like a mover) to 1 (looks like a static surface), and the reasons in words,
    strongest first.

    Args:
        case, rows, visits: as for ``signs``.
    """
    found = signs(case, rows, visits)
    parts = {name: WEIGHTS[name] * value for name, value in found.items()}
    score = min(sum(parts.values()), 1.0)
    if moved(rows):
        return round(MOVER * score, 3), ()
    words = {
        "ground": "ground",
        "level": "level surface",
        "large": "larger than a vehicle",
        "lasting": f"stays at one place for {np.count_nonzero(standing(rows))} frames",
        "kept": "next to points that were kept",
        "brief": f"hit in {BRIEF} frames or fewer",
    }
    strongest = sorted(
        (name for name in parts if found[name] >= CLEAR), key=lambda name: -parts[name]
    )
    return round(score, 3), tuple(words[name] for name in strongest)


def cluster_sentence(cluster: RemovedCluster) -> str:
    """Describe a cluster of removed points: where it is, and why it looks right or wrong."""
    fact = (
        f"{cluster.did.capitalize()}: {cluster.what}, {extent(cluster)}, {when_and_where(cluster)}."
    )
    if cluster.what.startswith(MOVING):
        return f"{fact} Moves as movers do."
    if not cluster.why:
        return fact
    word = "Suspicious" if cluster.suspicion > DOUBTFUL else "Signs of a static surface"
    return f"{fact} {word}: {', '.join(cluster.why)}."


def _between(value: float, low: float, high: float) -> float:
    return float(np.clip((value - low) / (high - low), 0.0, 1.0))
