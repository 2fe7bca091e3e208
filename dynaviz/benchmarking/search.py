"""Parameter search: optuna proposes sets, cells evaluate them, and the added counts of all
sequences give one AA.

A search stores nothing except its cells. The choice of trials is seeded, so a restarted search
proposes the same sets, finds their cells finished, and continues; the same applies if the number of
trials is increased. Its values therefore always match the data, versions and parameters of the
stored cells.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_type_hints

from dynaviz.benchmarking.leaderboard import BenchRow, SearchResult
from dynaviz.benchmarking.plan import BenchPlan, ParameterSet, SearchSpec, SequenceSpec
from dynaviz.contracts import params, registry
from dynaviz.contracts.registry import suggest
from dynaviz.errors import DynavizError, MissingDependency, UsageError
from dynaviz.io.atomic import write_atomic
from dynaviz.scores.collect import combined

if TYPE_CHECKING:
    from dynaviz.benchmarking.runner import CellRunner

# trials proposed together, for parallel workers; constant, so that trials do not depend on their
# number
BATCH = 4
# multiples of a default that end its range
SHRUNK = (0.5, 0.7, 0.85)
GROWN = (2.0, 1.4, 1.2, 1.1)
DIGITS = 4  # significant digits of a proposed value; more are meaningless and make names long


def check(plan: BenchPlan) -> None:
    """Check the ranges of a search before any cell runs.

    Raises:
        MissingDependency: if optuna is not installed.
        UsageError: for an invalid range, or a parameter that does not exist or is not a number.
    """
    _optuna()
    assert plan.search
    for method, ranges in plan.search.ranges.items():
        distributions(method, ranges)
        if not any(known.method == method and not known.variant for known in plan.sets):
            raise UsageError(
                f"--range {method}: {method} is not a method of this bench. Add -m {method}"
            )


def search(
    runner: CellRunner, spec: SearchSpec, sources: list[SequenceSpec], out: Path
) -> tuple[list[BenchRow], list[SearchResult]]:
    """Search the parameters of each method that has ranges, and write its ``out/best-METHOD.toml``.

    Returns:
        The rows of all trials, and one result per method.

    Raises:
        DynavizError: if AA is undefined for every set.
    """
    rows = []
    results = []
    for method in spec.ranges:
        trials = _search(runner, method, spec, sources)
        rows += [row for trial in trials for row in trial.rows]
        results.append(_conclude(method, trials, spec, sources, out))
    return rows, results


@dataclass(frozen=True)
class Trial:
    """One evaluated parameter set.

    Attributes:
        parameter_set: None if its values are invalid in combination.
        aa: associated accuracy in percent over the added counts; None if undefined or if a cell
            failed.
        rows: its cells, one per sequence.
    """

    parameter_set: ParameterSet | None
    aa: float | None
    rows: list[BenchRow]


def _search(
    runner: CellRunner, method: str, spec: SearchSpec, sources: list[SequenceSpec]
) -> list[Trial]:
    """Evaluate the default parameters, then all trials."""
    optuna = _optuna()
    sampler = {"random": optuna.samplers.RandomSampler, "bayes": optuna.samplers.TPESampler}[
        spec.kind
    ](seed=spec.seed)
    study = optuna.create_study(direction="maximize", sampler=sampler)
    space = distributions(method, spec.ranges[method])
    default = next(
        known for known in runner.plan.sets if known.method == method and not known.variant
    )
    trials = _evaluate(runner, [default], sources)
    while (left := spec.trials + 1 - len(trials)) > 0:
        proposals = [study.ask(fixed_distributions=space) for _ in range(min(BATCH, left))]
        batch = _evaluate(
            runner, [_proposed(default, proposal.params) for proposal in proposals], sources
        )
        for proposal, trial in zip(proposals, batch, strict=True):
            if trial.aa is None:
                study.tell(proposal, state=optuna.trial.TrialState.FAIL)
            else:
                study.tell(proposal, trial.aa)
        trials += batch
    return trials


def _proposed(default: ParameterSet, values: Mapping[str, Any]) -> ParameterSet | None:
    short = {k: float(f"{v:.{DIGITS}g}") if isinstance(v, float) else v for k, v in values.items()}
    try:
        return default.changed(short)
    except UsageError:  # values that are valid on their own, but not together
        return None


def _evaluate(
    runner: CellRunner, sets: list[ParameterSet | None], sources: list[SequenceSpec]
) -> list[Trial]:
    """Run sets on all sequences; the AA of a set is computed from its added counts."""
    rows = runner.rows([candidate for candidate in sets if candidate], sources)
    trials: list[Trial] = []
    for candidate in sets:
        own = list(
            {row.folder: row for row in rows if row.cell.parameter_set == candidate}.values()
        )
        results = [row.result for row in own if row.result]
        aa = combined(results).metrics.get("AA") if results and len(results) == len(own) else None
        trials.append(Trial(candidate, aa, own))
    return trials


def _conclude(
    method: str, evaluated: list[Trial], spec: SearchSpec, sources: list[SequenceSpec], out: Path
) -> SearchResult:
    """Choose the best set, the first of equals, and write it as a file for ``--config``."""
    scored = [
        (trial.parameter_set, trial.aa)
        for trial in evaluated
        if trial.parameter_set and trial.aa is not None
    ]
    if not scored:
        raise DynavizError(
            f"{method}: AA is undefined for every parameter set. Search on sequences with static "
            "and dynamic ground "
            "truth, and look at the errors of the cells."
        )
    best, aa = max(scored, key=lambda pair: pair[1])
    first, *trials = evaluated
    default_aa = first.aa
    failed = sum(trial.aa is None for trial in trials)
    ranges = ", ".join(f"{name} = {text}" for name, text in spec.ranges[method].items())
    default = "undefined" if default_aa is None else f"{default_aa:.2f} %"
    names = ", ".join(source.name for source in sources)
    remark = [
        f"{method}: found by dynaviz bench --search {spec.kind}: AA {aa:.2f} % on {names}.",
        f"Best of {len(trials)} trials ({failed} failed) with seed {spec.seed} over {ranges}.",
        f"The default parameters give AA {default} there."
        + ("" if best.variant else " No trial was better."),
    ]
    preset = out / f"best-{method}.toml"
    values = registry.load("methods", method).Params(**best.parameters)
    table = params.to_toml(method, values, {"online": best.online, "seed": best.seed})
    write_atomic(preset, "".join(f"# {line}\n" for line in remark).encode() + b"\n" + table)
    return SearchResult(best, preset, aa, default_aa, len(trials), failed)


def default_ranges(method: str) -> dict[str, str]:
    """A range around the default of each numeric parameter.

    From half to twice, or as far as the method permits.

    Parameters whose default is 0 or negative are left out: 0 mostly means off or automatic.
    """
    kind = registry.load("methods", method).Params
    hints = get_type_hints(kind)
    defaults = dataclasses.asdict(kind())
    ranges = {}
    for name, value in defaults.items():
        if hints[name] in (int, float) and value > 0:
            low, high = (_valid_end(method, name, value, factors) for factors in (SHRUNK, GROWN))
            if low < high:
                ranges[name] = f"log:{low}:{high}"
    return ranges


def _valid_end(method: str, name: str, value: float, factors: tuple[float, ...]) -> float:
    """The first multiple of a value that is a valid parameter."""
    for factor in factors:
        end = type(value)(float(f"{value * factor:.{DIGITS}g}"))
        try:
            ParameterSet.of(method, "", {name: end})
        except UsageError:
            continue
        if end > 0:
            return end
    return value


def distributions(method: str, ranges: Mapping[str, str]) -> dict[str, Any]:
    """The distribution of each parameter, for optuna.

    Raises:
        UsageError: for an invalid range, or a parameter that does not exist or is not a number.
    """
    from optuna.distributions import FloatDistribution, IntDistribution

    kinds = get_type_hints(registry.load("methods", method).Params)
    space: dict[str, Any] = {}
    for name, text in ranges.items():
        place = f"--range {method}.{name}={text}"
        if name not in kinds:
            raise UsageError(f"{place}: {method} has no parameter '{name}'. {suggest(name, kinds)}")
        if kinds[name] not in (int, float):
            raise UsageError(f"{place}: {name} is not a number. Use --grid for its values")
        try:
            log = str(text).startswith("log:")
            bounds = str(text).removeprefix("log:")
            low, high = map(kinds[name], bounds.split(":"))
            space[name] = (IntDistribution if kinds[name] is int else FloatDistribution)(
                low, high, log=log
            )
        except ValueError:
            numbers = "integers" if kinds[name] is int else "numbers"
            raise UsageError(
                f"{place}: write LOW:HIGH, or log:LOW:HIGH above 0, with {numbers}"
            ) from None
        for end in (low, high):
            try:
                ParameterSet.of(method, "", {name: end})
            except UsageError as error:
                raise UsageError(f"{place}: {str(error).removeprefix('--set: ')}") from None
    return space


def _optuna() -> Any:
    try:
        import optuna
    except ImportError:
        raise MissingDependency(
            "the parameter search needs optuna. Install it with: pip install optuna"
        ) from None
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    return optuna
