"""Result: everything a run answers, as plain values; saved whole or not at all, and shown as a table."""

from __future__ import annotations

import dataclasses
import io
import json
import os
import platform
from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib import metadata
from typing import TYPE_CHECKING, Any, Literal

from dynaviz.errors import DataError
from dynaviz.io.atomic import write_atomic
from dynaviz.io.plain_json import read_json

if TYPE_CHECKING:
    from rich.console import Console, RenderableType

SCHEMA = 1
RecordMode = Literal["full", "errors", "scores"]  # how much a recording holds
_HINT = "Give the result.json of a run"


@dataclass(frozen=True)
class Result:
    """The answer of one run; the fields are those of ``result.json``.

    Attributes:
        method, sequence: what ran on what; ``sequence`` holds name, digest, frames and points.
        variant: a short name for the parameters, where a bench runs several sets of them.
        parameters: the method's parameters; ``n_parameters`` counts them (paper, runtime table).
        scoring: ``mask`` (labels by index) or ``nn`` (nearest neighbour in a cleaned map).
        sections: what the metrics found: counts, metrics, error_distance, breakdown, reasons ...; None where undefined.
        runtime: mean_s and std_s per frame of the method alone, prepare_s before it, frames, threads, peak_rss_mb.
        labels_sha256: digest of all labels in the order of the sequence.
        recording_sha256: digest of the recording's file, or None.
        record: how much that recording holds, or None.
        instrumented: whether the method's states were recorded while it ran, so that its runtime is not comparable.
        environment: versions and machine. ``command``: what was typed.
    """

    method: str
    parameters: dict[str, Any]
    sequence: dict[str, Any]
    sections: dict[str, Any] = field(default_factory=dict)
    runtime: dict[str, Any] = field(default_factory=dict)
    online: bool = False
    seed: int = 0
    variant: str = ""
    scoring: str = "mask"
    labels_sha256: str | None = None
    recording_sha256: str | None = None
    record: str | None = None
    instrumented: bool = False
    environment: dict[str, Any] = field(default_factory=dict)
    command: str = ""

    @property
    def metrics(self) -> Mapping[str, float | None]:
        """SA, DA, AA, HA, precision and IoU in percent; None where undefined."""
        metrics: dict[str, float | None] = self.sections.get("metrics", {})
        return metrics

    @property
    def counts(self) -> Mapping[str, int]:
        """static_kept, static_removed, dynamic_removed, dynamic_kept, unlabelled."""
        counts: dict[str, int] = self.sections.get("counts", {})
        return counts

    @property
    def failures(self) -> list[dict[str, Any]]:
        """The failure cases, costliest first; empty where nobody looked for them."""
        cases: list[dict[str, Any]] = self.sections.get("failures", {}).get("cases", [])
        return cases

    @property
    def causes(self) -> dict[str, dict[str, dict[str, int]]]:
        """Cases and points by kind of error and cause, most points first; empty where nobody looked for them."""
        causes: dict[str, dict[str, dict[str, int]]] = self.sections.get("failures", {}).get("causes", {})
        return causes

    def to_dict(self) -> dict[str, Any]:
        """The content of ``result.json``."""
        plain = dataclasses.asdict(self)
        sections = plain.pop("sections")
        return {"schema": SCHEMA, "n_parameters": len(self.parameters), **plain, **sections}

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write ``result.json``, whole or not at all."""
        write_atomic(path, json.dumps(self.to_dict(), indent=1, allow_nan=False).encode())

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Result:
        """Read a ``result.json``.

        Raises:
            DataError: where the file is none, or was written by a newer dynaviz.
        """
        return cls.from_dict(read_json(path, _HINT), path)

    @classmethod
    def from_dict(cls, plain: Any, path: str | os.PathLike[str]) -> Result:
        """The inverse of ``to_dict``; ``path`` is where the values come from.

        Raises:
            DataError: as ``load``.
        """
        if not isinstance(plain, dict) or not plain.keys() >= {"method", "parameters", "sequence"}:
            raise DataError(path, "is not the result of a run", hint=_HINT)
        plain = dict(plain)
        schema = plain.pop("schema", 0)
        if isinstance(schema, int) and schema > SCHEMA:
            raise DataError(path, "was written by a newer dynaviz", hint="Upgrade with: pip install -U dynaviz")
        plain.pop("n_parameters", None)
        if wrong := next((name for name, kind in _OUTLINE.items() if not fits(plain.get(name, kind), kind)), None):
            raise DataError(path, f"has something else in '{wrong}' than a result has", hint="Run the method again")
        known = {f.name for f in dataclasses.fields(cls)} - {"sections"}
        return cls(
            **{k: v for k, v in plain.items() if k in known},
            sections={k: v for k, v in plain.items() if k not in known},
        )

    def __rich__(self) -> RenderableType:
        from dynaviz.results.tables import result_table

        return result_table([self])

    def __str__(self) -> str:
        return self._rendered().export_text()

    def _repr_html_(self) -> str:
        return self._rendered().export_html(inline_styles=True, code_format="<pre>{code}</pre>")

    def _rendered(self) -> Console:
        from rich.console import Console

        console = Console(file=io.StringIO(), record=True, width=160)
        console.print(self)
        return console


def label(method: str, variant: str, online: bool) -> str:
    """A method, and what sets a run of it apart."""
    apart = dict.fromkeys([variant, "online" if online else ""])
    return " ".join([method, *(f"({text})" for text in apart if text)])


def fits(value: Any, kind: Any) -> bool:
    """Whether a value from a file is as a pattern says.

    A pattern is one of several types, or a dict with one pattern for all values, or a list with one for all items; an
    empty dict or list takes any values. A pattern fits itself.
    """
    if value is kind:
        return True
    if isinstance(kind, dict):
        return isinstance(value, dict) and all(fits(v, k) for k in kind.values() for v in value.values())
    if isinstance(kind, list):
        return isinstance(value, list) and all(fits(v, k) for k in kind for v in value)
    return isinstance(value, kind) and not (isinstance(value, bool) and kind is not bool)


_NUMBER, _TEXT = (int, float, type(None)), (str, type(None))
_OUTLINE: dict[str, Any] = {  # of what every reader of a result relies on; the rest is the metrics' own
    **dict.fromkeys(("method", "variant", "scoring", "command"), str),
    **dict.fromkeys(("labels_sha256", "recording_sha256", "record"), _TEXT),
    **{name: {} for name in ("parameters", "sequence", "environment", "failures")},
    **dict.fromkeys(("online", "instrumented"), bool),
    "seed": int,
    "runtime": {"": _NUMBER},
    "counts": {"": int},
    "metrics": {"": _NUMBER},
    "reasons": {"": {}},
}


def environment() -> dict[str, Any]:
    """Versions of what decides about labels and speed, and the machine."""
    versions = {name: metadata.version(name) for name in ("dynaviz", "numba", "numpy", "scipy", "rerun-sdk")}
    return {
        "versions": {"python": platform.python_version(), **versions},
        "machine": {"system": platform.system(), "arch": platform.machine(), "cores": os.cpu_count()},
    }
