"""The method's reasons by outcome, and the cost of wrong points by reason."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from dynaviz.contracts.method import MethodInfo
from dynaviz.contracts.metric import Figure, Labelled
from dynaviz.contracts.scan import ERRORS, Outcome
from dynaviz.scores.scores import Counts, percentage_points_lost
from dynaviz.scores.sections import ReasonCost, Reasons

_CODES = 256
_KINDS: dict[str, Outcome] = {
    **ERRORS,
    "dynamic_removed": Outcome.DYNAMIC_REMOVED,
    "static_kept": Outcome.STATIC_KEPT,
}


class ReasonsMetric:
    """Section ``reasons``: points by outcome and reason, the cost of each reason, and the meaning
    of each.

    ``cost`` is the number of percentage points of SA and DA lost to the wrong points of a reason;
    the costs of all reasons add up to 100 - SA and 100 - DA.
    """

    def __init__(self, info: MethodInfo) -> None:
        self._legend = info.reasons
        self._crossed = np.zeros((len(Outcome), _CODES), np.int64)

    def update(self, labelled: Labelled) -> Mapping[str, float]:
        """Add the points of one scan. The curves are the wrong points of this frame by reason."""
        flat = labelled.outcome * np.int32(_CODES) + labelled.reasons
        crossed = np.bincount(flat, minlength=self._crossed.size).reshape(self._crossed.shape)
        self._crossed += crossed
        return {
            f"reasons/{kind}/{reason.name}": float(crossed[_KINDS[kind], code])
            for kind in ERRORS
            for code, reason in enumerate(self._legend)
        }

    def finish(self) -> Mapping[str, Reasons]:
        """The section, most frequent reasons first."""
        counts = Counts.of_histogram(self._crossed.sum(1))
        static = counts.static_kept + counts.static_removed
        dynamic = counts.dynamic_kept + counts.dynamic_removed
        wrong = self._crossed[Outcome.FALSE_POSITIVE], self._crossed[Outcome.FALSE_NEGATIVE]
        cost = {
            self._name(code): ReasonCost(
                SA=float(percentage_points_lost(wrong[0][code], static)) if static else None,
                DA=float(percentage_points_lost(wrong[1][code], dynamic)) if dynamic else None,
            )
            for code in np.flatnonzero(wrong[0] + wrong[1]).tolist()
        }
        by_kind = {kind: self._by_name(outcome) for kind, outcome in _KINDS.items()}
        legend = {reason.name: reason.meaning for reason in self._legend}
        return {"reasons": Reasons(**by_kind, cost=cost, legend=legend)}

    def figures(self) -> Mapping[str, Figure]:
        """None."""
        return {}

    def _by_name(self, outcome: Outcome) -> dict[str, int]:
        counts = self._crossed[outcome]
        order = np.argsort(-counts, kind="stable")
        return {self._name(code): int(counts[code]) for code in order.tolist() if counts[code]}

    def _name(self, code: int) -> str:
        """The name of a reason; a code that the method does not declare shows as a number."""
        return self._legend[code].name if code < len(self._legend) else f"code {code}"
