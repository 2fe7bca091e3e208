"""Whether a sequence has enough scans and rings for each method, by what methods found on thinned
real drives.

``benchmarks/sampling.py`` writes ``sampling.json`` beside each method: rows of method, drive,
looks, rings, SA and DA.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from dynaviz.arrays import F64
from dynaviz.contracts import registry

NEAR = 10.0  # metres: a place is seen from scans within this distance
ENOUGH = 0.5  # share of its DA in dense data that a method must keep


@dataclass(frozen=True)
class Sampling:
    """How densely a sequence samples space, and what that costs each method.

    Attributes:
        looks: number of scans that see a place.
        rings: of the sensor; None if unknown.
        kept: by method, the share of its DA in dense data that it keeps on real drives with as few
            looks and rings.
    """

    looks: int
    rings: int | None
    kept: Mapping[str, float]

    @property
    def poor(self) -> dict[str, float]:
        """The methods that keep less than ``ENOUGH``, worst first."""
        return {
            name: share
            for name, share in sorted(self.kept.items(), key=lambda each: each[1])
            if share < ENOUGH
        }

    def __str__(self) -> str:
        rings = f", with {self.rings} rings" if self.rings else ""
        text = f"A place is seen by {self.looks} scans{rings}."
        if not self.poor:
            return f"{text} That is enough for every method."
        losses = ", ".join(f"{name} ({share:.0%})" for name, share in self.poor.items())
        left = ", ".join(name for name in self.kept if name not in self.poor) or "no method"
        return (
            f"{text} On real drives with as few, these keep less than half of their DA: {losses}. "
            f"Enough for {left}."
        )


def looks(
    positions: Iterable[F64], numbers: Sequence[int] | None = None, frames: int | None = None
) -> int:
    """Number of scans that see a place.

    Of those within ``NEAR`` of it on the way, at the mean speed.

    Args:
        positions: (3,) metres, world frame, of scans.
        numbers: their positions in the sequence, if not all were read.
        frames: length of the sequence, if not all were read.
    """
    where = np.array(list(positions)).reshape(-1, 3)
    follows = np.diff(np.arange(len(where)) if numbers is None else numbers) == 1
    steps = np.linalg.norm(np.diff(where, axis=0), axis=1)[follows]
    most = len(where) if frames is None else frames
    step = float(steps.mean()) if len(steps) else 0.0
    return most if step * most <= 2 * NEAR else 1 + int(2 * NEAR / step)


def sampling(seen: int, rings: int | None) -> Sampling:
    """What so many looks and rings cost each method that was measured."""
    names = sorted({row["method"] for row in measured()})
    return Sampling(seen, rings, {name: _kept(name, seen, rings) for name in names})


def _kept(method: str, seen: int, rings: int | None) -> float:
    """The share of its DA that a method keeps, as mean over drives, interpolated over the logarithm
    of each axis.
    """
    rows = [row for row in measured() if row["method"] == method]
    shares = []
    for drive in {row["drive"] for row in rows}:
        share = 1.0
        for axis, value in (("looks", seen), ("rings", rings)):
            other = "rings" if axis == "looks" else "looks"
            here = [row for row in rows if row["drive"] == drive]
            most = max(row[other] for row in here)
            curve = sorted((row[axis], row["DA"]) for row in here if row[other] == most)
            at, found = np.array(curve).T
            if value is not None and found[-1] > 0:
                share *= min(float(np.interp(np.log(value), np.log(at), found / found[-1])), 1.0)
        shares.append(share)
    return float(np.mean(shares))


@cache
def measured() -> list[dict[str, Any]]:
    """What methods found on thinned drives.

    Rows with the method, the drive, looks, rings, and SA and DA in percent.
    """
    return [
        row
        for file in registry.files_of_methods("sampling.json")
        for row in json.loads(file.read_text(encoding="utf-8"))
    ]
