"""What decisions of a person are worth: curves, and how far probabilities can be trusted.

    python benchmarks/review.py RUN ... [--fit RUN ...] [-o review.json]

For each run on a sequence with ground truth: the candidates, which are found without it, in their
order; an oracle that answers from the truth what a person would see, whether a place is mostly
static or mostly dynamic; and the scores after 0, 5, 20 and 50 answers, and after all of them. A
place without labelled points, or of which less than three quarters are of one kind, is skipped, and
counts as a look. With --fit, the weights of
``dynaviz/reviews/calibration.py`` are fitted to the candidates of other runs, and printed; the
reliability table is that of the first runs.
"""

from __future__ import annotations

import argparse
import itertools
import json
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import minimize

from dynaviz.contracts.scan import Label, outcomes, stream
from dynaviz.reviews import calibration
from dynaviz.reviews.applying import NONE, Applied
from dynaviz.reviews.candidates import Candidate, candidates
from dynaviz.reviews.decisions import ReviewDecision, Verdict
from dynaviz.runs.run import open_run
from dynaviz.scores.scores import Counts

LOOKS = (0, 5, 20, 50)
MOSTLY = 0.75  # share of a place's labelled points from which a person would not split it
BINS = (0.0, 0.02, 0.05, 0.1, 0.2, 0.4, 0.6, 0.8, 1.01)
SMOOTH = 1.0  # of the squared weights, so that a feature that few candidates have stays small


@dataclass(frozen=True)
class Judged:
    """A candidate with the answer of the oracle; ``truth`` is None where nothing is labelled."""

    candidate: Candidate
    truth: Verdict | None

    @property
    def wrong(self) -> bool:
        """Whether the run's answer is wrong."""
        return self.truth == ("dynamic" if self.candidate.answered == "kept" else "static")


class Reviewed:
    """A run, its candidates, and what the oracle says of each."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        run = open_run(folder)
        self.sequence = run.sequence()
        self.name = f"{run.result.method} on {run.result.sequence.name}"
        self.labels = run.labels
        self.scans = list(stream(self.sequence))
        self.origin = self.sequence.origin
        start = time.perf_counter()
        found = candidates(self.scans, self.labels, self.origin)
        self.seconds = time.perf_counter() - start
        self.judged = [Judged(each, self._truth(each)) for each in found]

    def _truth(self, candidate: Candidate) -> Verdict | None:
        applied = Applied([ReviewDecision("static", candidate.region)], self.origin)
        counts = np.zeros(2, np.int64)
        removed = candidate.answered == "removed"
        for frame in range(candidate.first_frame, candidate.last_frame + 1):
            scan = self.scans[frame]
            inside = (applied.verdicts(scan) != NONE) & (self.labels[frame] == removed)
            if inside.any() and scan.labels is not None:
                counts += np.bincount(scan.labels[inside], minlength=256)[:2]
        if counts.max() <= MOSTLY * counts.sum():
            return None
        return "static" if counts[Label.STATIC] >= counts[Label.DYNAMIC] else "dynamic"

    def scores(self, looks: int) -> dict[str, float | None]:
        """SA, DA and AA after so many looks."""
        made = [
            ReviewDecision(each.truth, each.candidate.region)
            for each in self.judged[:looks]
            if each.truth is not None
        ]
        applied = Applied(made, self.origin)
        counts = Counts()
        for scan, dynamic in zip(self.scans, self.labels, strict=True):
            answers, _ = applied.answers(scan, dynamic)
            counts += Counts.of(outcomes(scan.labels, answers))
        return {name: counts.metrics()[name] for name in ("SA", "DA", "AA")}

    def curve(self) -> dict[str, Any]:
        """The scores after each number of looks, and after all of them."""
        return {
            "run": self.name,
            "candidates": len(self.judged),
            "seconds": round(self.seconds, 2),
            "after": {str(looks): self.scores(looks) for looks in LOOKS},
            "all": self.scores(len(self.judged)),
            "first": [
                {"what": each.candidate.sentence, "truth": each.truth} for each in self.judged[:20]
            ],
        }


def fitted(judged: list[Judged], answered: str) -> tuple[float, ...]:
    """The weights of a logistic regression: the constant, then one for each feature."""
    chosen = [
        each for each in judged if each.candidate.answered == answered and each.truth is not None
    ]
    x = np.array([list(each.candidate.features.values()) for each in chosen])
    x = np.column_stack([np.ones(len(x)), x])
    wrong = np.array([each.wrong for each in chosen])

    def loss(weights: Any) -> Any:
        total = x @ weights
        likelihood = np.logaddexp(0, total) - wrong * total
        gradient = x.T @ (1 / (1 + np.exp(-total)) - wrong) + 2 * SMOOTH * weights
        return likelihood.sum() + SMOOTH * (weights @ weights), gradient

    found = minimize(loss, np.zeros(x.shape[1]), jac=True, method="L-BFGS-B")
    return tuple(round(float(weight), 3) for weight in found.x)


def reliability(judged: list[Judged]) -> list[dict[str, float]]:
    """Stated and found shares of wrong answers, by the stated probability."""
    rows = []
    known = [each for each in judged if each.truth is not None]
    for low, high in itertools.pairwise(BINS):
        inside = [each for each in known if low <= each.candidate.wrong < high]
        if inside:
            rows.append(
                {
                    "from": low,
                    "to": min(high, 1.0),
                    "candidates": len(inside),
                    "stated": float(np.mean([each.candidate.wrong for each in inside])),
                    "found": float(np.mean([each.wrong for each in inside])),
                }
            )
    return rows


def main() -> None:
    """Read the command line, print tables, and write the figures."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("runs", nargs="*", type=Path)
    parser.add_argument("--fit", nargs="*", type=Path, default=[])
    parser.add_argument("-o", "--out", type=Path)
    given = parser.parse_args()
    if given.fit:
        known = [each for run in given.fit for each in Reviewed(run).judged]
        for answered in ("kept", "removed"):
            calibration.WEIGHTS[answered] = fitted(known, answered)
            print(answered, calibration.WEIGHTS[answered])
    curves = []
    judged: list[Judged] = []
    for folder in given.runs:
        run = Reviewed(folder)
        curves.append(run.curve())
        judged += run.judged
        row = curves[-1]
        values = [row["after"][str(looks)]["AA"] for looks in LOOKS] + [row["all"]["AA"]]
        text = " ".join("   n/a" if value is None else f"{value:6.2f}" for value in values)
        print(f"{text}  SA {row['after']['20']['SA']:.2f}  {row['seconds']:5.1f} s  {run.name}")
    table = reliability(judged)
    for row in table:
        print(" ".join(f"{name} {value:.3g}" for name, value in row.items()))
    if given.out:
        given.out.write_text(json.dumps({"curves": curves, "reliability": table}, indent=1))


if __name__ == "__main__":
    main()
