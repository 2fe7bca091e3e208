"""The search for better parameters: optuna proposes, cells answer, counts of all sequences add up to one AA.

Nothing of a search is stored but its cells. The choice of trials is seeded, so a search that is begun again proposes
the same sets, finds their cells done, and goes on where it was left; with more trials it goes on from there. So no
value can be of other data, versions or parameters than the cells that are there.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_type_hints

from dynaviz import params, registry
from dynaviz.benchmarking.leaderboard import BenchRow, SearchResult
from dynaviz.benchmarking.plan import BenchPlan, ParameterSet, SearchSpec, SequenceSpec
from dynaviz.errors import DynavizError, MissingDependency, UsageError
from dynaviz.io.atomic import write_atomic
from dynaviz.registry import suggest
from dynaviz.results.collect import combined

if TYPE_CHECKING:
    from dynaviz.benchmarking.runner import CellRunner

BATCH = 4  # trials that are proposed together, so that workers share them; always as many, so that all benches agree
DIGITS = 4  # of a parameter that was found: more mean nothing, and make names long


def check(plan: BenchPlan) -> None:
    """Refuse what cannot be searched before anything runs.

    Raises:
        MissingDependency: without optuna.
        UsageError: for a range that is none, or of a parameter that does not exist or is no number.
    """
    _optuna()
    assert plan.search
    for method, ranges in plan.search.ranges.items():
        distributions(method, ranges)
        if not any(what.method == method and not what.variant for what in plan.sets):
            raise UsageError(f"--range {method}: {method} is not among the methods of the bench: add -m {method}")


def search(
    desk: CellRunner, wish: SearchSpec, sources: list[SequenceSpec], out: Path
) -> tuple[list[BenchRow], list[SearchResult]]:
    """Search the parameters of each method that has ranges, and write ``out/best-METHOD.toml`` each.

    Returns:
        The rows of all trials, and what was found.

    Raises:
        DynavizError: where AA is undefined for every set.
    """
    rows, found = [], []
    for method in wish.ranges:
        tried = _search(desk, method, wish, sources)
        rows += [row for _, _, of_set in tried for row in of_set]
        found.append(_conclude(method, tried, wish, sources, out))
    return rows, found


Tried = tuple[ParameterSet | None, float | None, list[BenchRow]]
"""A set, None where its values contradict each other; its AA, None where undefined or failed; its rows."""


def _search(desk: CellRunner, method: str, wish: SearchSpec, sources: list[SequenceSpec]) -> list[Tried]:
    """The defaults, then all trials."""
    optuna = _optuna()
    sampler = {"random": optuna.samplers.RandomSampler, "bayes": optuna.samplers.TPESampler}[wish.kind](seed=wish.seed)
    study = optuna.create_study(direction="maximize", sampler=sampler)
    space = distributions(method, wish.ranges[method])
    default = next(what for what in desk.plan.sets if what.method == method and not what.variant)
    tried = _try(desk, [default], sources)
    while (left := wish.trials + 1 - len(tried)) > 0:
        asked = [study.ask(fixed_distributions=space) for _ in range(min(BATCH, left))]
        answers = _try(desk, [_proposed(default, trial.params) for trial in asked], sources)
        for trial, (_, aa, _) in zip(asked, answers, strict=True):
            if aa is None:
                study.tell(trial, state=optuna.trial.TrialState.FAIL)
            else:
                study.tell(trial, aa)
        tried += answers
    return tried


def _proposed(default: ParameterSet, values: Mapping[str, Any]) -> ParameterSet | None:
    short = {k: float(f"{v:.{DIGITS}g}") if isinstance(v, float) else v for k, v in values.items()}
    try:
        return default.changed(short)
    except UsageError:  # values that are right one by one, but not together
        return None


def _try(desk: CellRunner, sets: list[ParameterSet | None], sources: list[SequenceSpec]) -> list[Tried]:
    """Run sets on all sequences and score each by what adds up."""
    rows = desk.rows([what for what in sets if what], sources)
    answers: list[Tried] = []
    for what in sets:
        mine = list({row.folder: row for row in rows if row.cell.what == what}.values())
        results = [row.result for row in mine if row.result]
        aa = combined(results).metrics.get("AA") if results and len(results) == len(mine) else None
        answers.append((what, aa, mine))
    return answers


def _conclude(
    method: str, tried: list[Tried], wish: SearchSpec, sources: list[SequenceSpec], out: Path
) -> SearchResult:
    """Choose the best, the first of equals, and write it as a file for ``--config``."""
    scored = [(what, aa) for what, aa, _ in tried if what and aa is not None]
    if not scored:
        raise DynavizError(f"{method}: no set of parameters has an AA. Search on sequences with static and dynamic "
                           "ground truth, and look at the errors of its cells.")  # fmt: skip
    best, aa = max(scored, key=lambda one: one[1])
    default_aa, trials, failed = tried[0][1], len(tried) - 1, sum(aa is None for _, aa, _ in tried[1:])
    ranges = ", ".join(f"{name} = {text}" for name, text in wish.ranges[method].items())
    default = "undefined" if default_aa is None else f"{default_aa:.2f} %"
    names = ", ".join(source.name for source in sources)
    remark = [
        f"{method}: found by dynaviz bench --search {wish.kind}: AA {aa:.2f} % on {names}.",
        f"The best of {trials} trials ({failed} failed) with seed {wish.seed} over {ranges}.",
        f"The default parameters have AA {default} there." + ("" if best.variant else " No trial was better."),
    ]
    preset = out / f"best-{method}.toml"
    values = registry.load("methods", method).Params(**best.parameters)
    table = params.to_toml(method, values, {"online": best.online, "seed": best.seed})
    write_atomic(preset, "".join(f"# {line}\n" for line in remark).encode() + b"\n" + table)
    return SearchResult(best, preset, aa, default_aa, trials, failed)


def distributions(method: str, ranges: Mapping[str, str]) -> dict[str, Any]:
    """What optuna draws each parameter from.

    Raises:
        UsageError: for a range that is none, or of a parameter that does not exist or is no number.
    """
    from optuna.distributions import FloatDistribution, IntDistribution

    kinds = get_type_hints(registry.load("methods", method).Params)
    space: dict[str, Any] = {}
    for name, text in ranges.items():
        place = f"--range {method}.{name}={text}"
        if name not in kinds:
            raise UsageError(f"{place}: {method} has no parameter '{name}'. {suggest(name, kinds)}")
        if kinds[name] not in (int, float):
            raise UsageError(f"{place}: {name} is no number. Give its values with --grid instead")
        try:
            log, bounds = str(text).startswith("log:"), str(text).removeprefix("log:")
            low, high = map(kinds[name], bounds.split(":"))
            space[name] = (IntDistribution if kinds[name] is int else FloatDistribution)(low, high, log=log)
        except ValueError:
            what = "whole numbers" if kinds[name] is int else "numbers"
            raise UsageError(f"{place}: write LOW:HIGH, or log:LOW:HIGH above 0, with {what}") from None
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
        raise MissingDependency("a search needs optuna. Install it with: pip install 'dynaviz[tune]'") from None
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    return optuna
