"""What a bench is made of: sequences x parameter sets = cells."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from dynaviz import params, registry


@dataclass(frozen=True)
class SequenceSpec:
    """A sequence of a bench.

    Attributes:
        name: of its folder and in tables.
        path: what ``dynaviz.open`` takes; empty for a simulated scene, which is written when the bench begins.
        frames: ``A:B``; for a simulated scene the number of sweeps.
        stride, sensor, poses, points_in, deskew: as in ``dynaviz.open``.
        scene: a simulated scene's name, or empty.
        seed: of the simulated scene.
    """

    name: str
    path: str = ""
    frames: str | int | None = None
    stride: int = 1
    sensor: str | None = None
    scene: str = ""
    seed: int = 0
    poses: str | None = None
    points_in: str | None = None
    deskew: bool | None = None


@dataclass(frozen=True)
class ParameterSet:
    """A method with all its parameters.

    Attributes:
        method: its name.
        variant: what tells this set from others of the method; empty for the defaults.
        parameters: every parameter of the method.
        online, seed: as in ``dynaviz.run``.
    """

    method: str
    variant: str
    parameters: Mapping[str, Any]
    online: bool = False
    seed: int = 0

    @classmethod
    def of(
        cls,
        method: str,
        variant: str = "",
        values: Mapping[str, Any] | None = None,
        *,
        preset: str | None = None,
        config: str | None = None,
        online: bool | None = None,
        seed: int | None = None,
    ) -> ParameterSet:
        """Resolve and check parameters.

        Raises:
            UsageError: for a method, preset, parameter or value that does not exist.
        """
        kind = registry.load("methods", method)
        resolved = params.resolve(kind, preset, config, settings(values or {}))
        return cls(
            method,
            variant,
            dataclasses.asdict(resolved.params),
            bool(online if online is not None else resolved.online),
            seed if seed is not None else resolved.seed or 0,
        )

    def changed(self, values: Mapping[str, Any]) -> ParameterSet:
        """This set with other values for some parameters, named after them."""
        other = ParameterSet.of(self.method, variant(values), {**self.parameters, **values})
        return dataclasses.replace(other, online=self.online, seed=self.seed)


@dataclass(frozen=True)
class BenchCell:
    """One run of a bench.

    Attributes:
        source, what: the sequence, and the method with its parameters.
        digest: of the sequence's content; empty where it could not be read.
        record: how much its recording holds.
        timing: whether its runtime must be comparable: nothing recorded, all cores.
    """

    source: SequenceSpec
    what: ParameterSet
    digest: str
    record: str
    timing: bool = False

    @property
    def path(self) -> Path:
        """Its folder below the bench's."""
        return Path(self.source.name, "-".join(filter(None, [self.what.method, self.what.variant])))


@dataclass(frozen=True)
class SearchSpec:
    """A search for the best parameters.

    Attributes:
        kind: ``random`` or ``bayes``.
        trials: how many sets to try, of each method.
        ranges: by method and parameter: ``LOW:HIGH`` or ``log:LOW:HIGH``.
        seed: for the choice of trials.
    """

    kind: str
    trials: int
    ranges: Mapping[str, Mapping[str, str]]
    seed: int = 0


@dataclass(frozen=True)
class BenchPlan:
    """A bench, checked.

    Attributes:
        sets, sources: what runs on what.
        holdout: names of the sequences that a search never looks at.
        search: None without one.
        record, workers, timing: as the keys of the file.
    """

    sets: tuple[ParameterSet, ...]
    sources: tuple[SequenceSpec, ...]
    holdout: frozenset[str] = frozenset()
    search: SearchSpec | None = None
    record: str = "errors"
    workers: int = 1
    timing: bool = False


def settings(values: Mapping[str, Any]) -> tuple[str, ...]:
    """Values as ``--set`` takes them."""
    import tomli_w

    return tuple(tomli_w.dumps({key: value}).strip() for key, value in values.items())


def variant(values: Mapping[str, Any]) -> str:
    """A short name for a choice of values, fit for a folder: the same values, the same name."""
    plain = ",".join(f"{key}={json.dumps(value, separators=(',', ':'))}" for key, value in sorted(values.items()))
    short = re.sub(r'"([A-Za-z_]\w*)"', r"\1", plain)
    fits = re.fullmatch(r"[\w.=,+\[\]-]{1,48}", short, re.ASCII)
    return short if fits else "set-" + hashlib.sha256(plain.encode()).hexdigest()[:8]
