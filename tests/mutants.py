"""Change the evaluation in one place at a time, and tell which changes no test notices; tests/README.md explains those.

    python tests/mutants.py [MODULE ...] [--sample N]

Each mutant lives in a forked process alone; no file changes. Texts, types and arguments that only guard stay as they are.
"""

from __future__ import annotations

import argparse
import ast
import collections
import copy
import os
import random
import signal
import sys
from collections.abc import Iterator
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path

import hypothesis
import numba  # noqa: F401  # what is imported here, no mutant waits for
import pytest
import scipy.sparse.csgraph  # noqa: F401

import dynaviz.testing  # noqa: F401

PACKAGE, TESTS = Path(__file__).parents[1] / "eval/dynaviz_eval", Path(__file__).parent / "eval"
MODULES = ("confusion", "breakdown", "error_distance", "reasons", "voxelwise", "failures", "cases", "blame", "spill")
OWN_TESTS = {"cases": "failures", "spill": "error_distance"}
SECONDS = 180
GUARDS = {"strict", "frozen", "slots", "eq", "assume_unique"}
SWAPS = {
    ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.In: ast.NotIn, ast.NotIn: ast.In, ast.And: ast.Or, ast.Or: ast.And,
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.FloorDiv: ast.Mult, ast.Pow: ast.Mult,
    ast.Mod: ast.Mult, ast.LShift: ast.RShift, ast.BitOr: ast.BitAnd, ast.BitAnd: ast.BitOr,
}  # fmt: skip


def changes(node: ast.AST) -> Iterator[tuple[str, str, object]]:
    """Kind, field and new value of each change of one node."""
    match node:
        case ast.Compare(ops=[op]) if type(op) in SWAPS:
            yield "comparison", "ops", [SWAPS[type(op)]()]
        case ast.BinOp(op=op) | ast.AugAssign(op=op) if type(op) in SWAPS:
            yield "arithmetic", "op", SWAPS[type(op)]()
        case ast.BoolOp(op=op):
            yield "boolean", "op", SWAPS[type(op)]()
        case ast.UnaryOp(op=op):
            yield "boolean" if isinstance(op, ast.Not) else "arithmetic", "op", ast.UAdd()
        case ast.Constant(value=bool(value)):
            yield "constant", "value", not value
        case ast.Constant(value=int(value) | float(value)):
            yield "constant", "value", value + 1
    if isinstance(node, ast.If | ast.IfExp):
        yield "condition", "test", ast.UnaryOp(ast.Not(), node.test)
    for name in ("body", "orelse"):
        block = getattr(node, name, None)
        for i, statement in enumerate(block if isinstance(block, list) else ()):
            plain = isinstance(statement, ast.AugAssign | ast.Continue) or (
                isinstance(statement, ast.Expr) and not isinstance(statement.value, ast.Constant)
            )
            stored = isinstance(statement, ast.Assign) and not isinstance(statement.targets[0], ast.Name | ast.Tuple)
            if plain or stored:
                yield "statement", name, [*block[:i], ast.Pass(), *block[i + 1 :]]


def mutants(tree: ast.Module) -> Iterator[tuple[str, int, ast.Module]]:
    """Kind, line and tree of every mutant."""
    guards = [n.value for n in ast.walk(tree) if isinstance(n, ast.keyword) and n.arg in GUARDS]
    types = [t for n in ast.walk(tree) for t in (getattr(n, "annotation", None), getattr(n, "returns", None)) if t]
    aside = {part for each in guards + types for part in ast.walk(each)}
    for number, node in enumerate(ast.walk(tree)):
        for kind, field, value in () if node in aside else changes(node):
            mutant = copy.deepcopy(tree)
            place = next(n for i, n in enumerate(ast.walk(mutant)) if i == number)
            old = getattr(node, field)
            line = (
                next((a.lineno for a, b in zip(old, value, strict=True) if a is not b), 0)
                if kind == "statement"
                else node.lineno
            )
            setattr(place, field, copy.deepcopy(value))
            yield kind, line, ast.fix_missing_locations(mutant)


def survives(name: str, mutant: ast.Module) -> bool:
    """Whether all tests pass with a mutant in the place of a module."""
    child = os.fork()
    if child:
        return os.waitpid(child, 0)[1] == 0
    signal.alarm(SECONDS)
    silence = os.open(os.devnull, os.O_WRONLY)
    os.dup2(silence, 1), os.dup2(silence, 2)
    failed = 1
    try:
        spec = spec_from_file_location(f"dynaviz_eval.{name}", PACKAGE / f"{name}.py")
        sys.modules[spec.name] = module = module_from_spec(spec)
        exec(compile(mutant, spec.origin, "exec"), module.__dict__)
        own = TESTS / f"test_{OWN_TESTS.get(name, name)}.py"
        rest = sorted(set(TESTS.glob("test_*.py")) - {own, TESTS / "test_report.py", TESTS / "test_published.py"})
        flags = (
            "-xq",
            "-pno:cacheprovider",
            "-Wignore::pytest.PytestAssertRewriteWarning",
            "--hypothesis-profile=mutants",
        )
        failed = pytest.main([*flags, *map(str, (own, *rest))])
    finally:
        os._exit(int(failed))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("modules", nargs="*", default=MODULES)
    parser.add_argument("--sample", type=int, default=sys.maxsize)
    options = parser.parse_args()
    hypothesis.settings.register_profile(
        "mutants",
        deadline=None,
        database=None,
        derandomize=True,
        phases=(hypothesis.Phase.explicit, hypothesis.Phase.generate),
    )
    every = [
        (name, *mutant)
        for name in options.modules
        for mutant in mutants(ast.parse((PACKAGE / f"{name}.py").read_text()))
    ]
    chosen = sorted(random.Random(0).sample(range(len(every)), min(options.sample, len(every))))
    tried, left = collections.Counter(), collections.Counter()
    for name, kind, line, mutant in (every[i] for i in chosen):
        tried[name, kind] += 1
        if survives(name, mutant):
            left[name, kind] += 1
            changed = ast.unparse(mutant).splitlines()
            before = ast.unparse(ast.parse((PACKAGE / f"{name}.py").read_text())).splitlines()
            print(
                f"{name}.py:{line}: {kind}",
                *[f"\n  + {new.strip()}" for new in changed if new not in before],
                flush=True,
            )
    for key, count in sorted(tried.items()):
        print(*key, f"{count - left[key]} of {count} killed")
    print(f"{tried.total() - left.total()} of {tried.total()} killed, of {len(every)} in all")


if __name__ == "__main__":
    main()
