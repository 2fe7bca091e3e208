"""Clean LiDAR maps of moving objects, score the cleaning point by point, and replay every mistake.

import dynaviz as dv
sequence = dv.open("path/to/sequence")
result = dv.run("octomap_gf", sequence, out="recordings/mine")
print(result)
"""

from __future__ import annotations

import importlib
import importlib.metadata
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from dynaviz.api import compare, open, run, score
    from dynaviz.benchmarking.bench import bench
    from dynaviz.benchmarking.tune import tune
    from dynaviz.cleaning import clean
    from dynaviz.cleaning.reviewing import review
    from dynaviz.diagnosis import doctor
    from dynaviz.errors import DataError, UsageError
    from dynaviz.explorer import explore, export_page
    from dynaviz.online import live
    from dynaviz.reports.reporting import report
    from dynaviz.runs.explanation import why
    from dynaviz.scores.result import Result

__all__ = [
    "DataError",
    "Result",
    "UsageError",
    "bench",
    "clean",
    "compare",
    "doctor",
    "explore",
    "export_page",
    "live",
    "open",
    "report",
    "review",
    "run",
    "score",
    "tune",
    "why",
]

_HOMES = {
    "bench": "dynaviz.benchmarking.bench",
    "clean": "dynaviz.cleaning",
    "compare": "dynaviz.api",
    "doctor": "dynaviz.diagnosis",
    "explore": "dynaviz.explorer",
    "export_page": "dynaviz.explorer",
    "live": "dynaviz.online",
    "open": "dynaviz.api",
    "report": "dynaviz.reports.reporting",
    "review": "dynaviz.cleaning.reviewing",
    "run": "dynaviz.api",
    "score": "dynaviz.api",
    "tune": "dynaviz.benchmarking.tune",
    "why": "dynaviz.runs.explanation",
    "DataError": "dynaviz.errors",
    "Result": "dynaviz.scores.result",
    "UsageError": "dynaviz.errors",
}


def __getattr__(
    name: str,
) -> Any:  # loaded when first used, so that `dynaviz --help` answers at once
    if name == "__version__":
        return importlib.metadata.version("dynaviz")
    if name not in _HOMES:
        raise AttributeError(f"module 'dynaviz' has no attribute '{name}'")
    return getattr(importlib.import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return [*__all__, "__version__"]  # what is meant to be used
