"""The plan of a bench: sequences x parameter sets = cells."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from dynaviz.contracts import params, registry
from dynaviz.sources.options import SequenceOptions


@dataclass(frozen=True)
class SequenceSpec:
    """A sequence of a bench.

    Attributes:
        name: name of its folder and in tables.
        path: path for ``dynaviz.open``; empty for a simulated scene, which is written when the
            bench starts.
        options: how to open it.
        scene: name of a simulated scene, or empty.
        sweeps: of the simulated scene; None for its own number.
        seed: random seed of the simulated scene.
    """

    name: str
    path: str = ""
    options: SequenceOptions = SequenceOptions()  # noqa: RUF009  # it is immutable
    scene: str = ""
    sweeps: int | None = None
    seed: int = 0

    def seeded(self, seeds: Sequence[int]) -> list[SequenceSpec]:
        """A simulated scene with each of the seeds; any other sequence as it is."""
        if not self.scene or not seeds:
            return [self]
        name = without_seed(self.name)
        return [
            dataclasses.replace(self, name=f"{name}-seed{seed}" if seed else name, seed=seed)
            for seed in seeds
        ]


@dataclass(frozen=True)
class ParameterSet:
    """A method with all its parameters.

    Attributes:
        method: name of the method.
        variant: short name of this set; empty for the defaults.
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
            UsageError: for an unknown method, preset or parameter, or an invalid value.
        """
        kind = registry.load("methods", method)
        resolved = params.resolve(kind, preset, config, values or {})
        return cls(
            method,
            variant,
            dataclasses.asdict(resolved.params),
            bool(online if online is not None else resolved.online),
            seed if seed is not None else resolved.seed or 0,
        )

    def seeded(self, seeds: Sequence[int]) -> list[ParameterSet]:
        """The set with each of the seeds, named after them if there are several."""
        return [
            dataclasses.replace(
                self,
                seed=seed,
                variant="-".join(filter(None, (self.variant, f"seed{seed}")))
                if len(seeds) > 1
                else self.variant,
            )
            for seed in seeds
        ] or [self]

    def changed(self, values: Mapping[str, Any]) -> ParameterSet:
        """A copy with other values for some parameters, named after them."""
        other = ParameterSet.of(self.method, variant(values), {**self.parameters, **values})
        return dataclasses.replace(other, online=self.online, seed=self.seed)


@dataclass(frozen=True)
class BenchCell:
    """One run of a bench.

    Attributes:
        source, parameter_set: the sequence, and the method with its parameters.
        digest: digest of the sequence's content; empty if it could not be read.
        record: how much its recording contains.
        timing: whether its runtime must be comparable: no recording, all cores.
        review: file with the decisions that its ground truth follows; empty without one.
    """

    source: SequenceSpec
    parameter_set: ParameterSet
    digest: str
    record: str
    timing: bool = False
    review: str = ""

    @property
    def path(self) -> Path:
        """Its folder, relative to the folder of the bench."""
        return Path(
            self.source.name,
            "-".join(filter(None, [self.parameter_set.method, self.parameter_set.variant])),
        )


@dataclass(frozen=True)
class SearchSpec:
    """A search for the best parameters.

    Attributes:
        kind: ``random`` or ``bayes``.
        trials: number of sets to try per method.
        ranges: by method and parameter: ``LOW:HIGH`` or ``log:LOW:HIGH``.
        seed: random seed of the choice of trials.
    """

    kind: str
    trials: int
    ranges: Mapping[str, Mapping[str, str]]
    seed: int = 0


@dataclass(frozen=True)
class BenchPlan:
    """A validated bench.

    Attributes:
        sets, sources: the parameter sets, each of which runs on every sequence.
        holdout: names of the sequences that are hidden from the search.
        search: None without a search.
        record, workers, timing, review: as the keys of the file.
        seeds: of methods and simulated scenes; empty if each has its own.
    """

    sets: tuple[ParameterSet, ...]
    sources: tuple[SequenceSpec, ...]
    holdout: frozenset[str] = frozenset()
    search: SearchSpec | None = None
    record: str = "errors"
    workers: int = 1
    timing: bool = False
    seeds: tuple[int, ...] = ()
    review: str = ""

    def pairs(self, source: SequenceSpec, parameter_set: ParameterSet) -> bool:
        """Whether the set runs on the sequence: with several seeds, on scenes of its own seed."""
        several = len(self.seeds) > 1 and bool(source.scene)
        return not several or source.seed == parameter_set.seed


def without_seed(name: str) -> str:
    """The name of a scene or variant without the seed at its end."""
    return re.sub(r"-?seed\d+$", "", name)


def settings(values: Mapping[str, Any]) -> tuple[str, ...]:
    """Values in the form of ``--set``."""
    import tomli_w

    return tuple(tomli_w.dumps({key: value}).strip() for key, value in values.items())


def variant(values: Mapping[str, Any]) -> str:
    """A short name for a choice of values, valid as a folder name.

    The same values give the same name.
    """
    plain = ",".join(
        f"{key}={json.dumps(value, separators=(',', ':'))}" for key, value in sorted(values.items())
    )
    short = re.sub(r'"([A-Za-z_]\w*)"', r"\1", plain)
    valid = re.fullmatch(r"[\w.=,+\[\]-]{1,48}", short, re.ASCII)
    return short if valid else "set-" + hashlib.sha256(plain.encode()).hexdigest()[:8]
