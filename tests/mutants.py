"""Change the code in one place at a time and list the changes that no test notices (see
tests/README.md).

    python tests/mutants.py [PATH ...] [--sample N]

A path is a module, or a folder with modules, which share the sample; without any, the modules of
the metrics. Its tests are those of the suite of the same place. Each mutant runs in a forked
process; no file is changed. Texts, types and arguments that only guard are not mutated, nor are
kernels, which numba compiles from their files.
"""

import argparse
import ast
import collections
import os
import random
import signal
import sys
from collections.abc import Iterator
from copy import deepcopy
from importlib.machinery import ModuleSpec, SourceFileLoader
from importlib.util import spec_from_file_location
from pathlib import Path
from types import ModuleType

import hypothesis
import numba  # noqa: F401  # imported once here, so the mutants' processes need not
import pytest
import scipy.sparse.csgraph  # noqa: F401

TESTS = Path(__file__).parent
ROOT = TESTS.parent
METRICS = (
    *("confusion", "breakdown", "error_distance", "reasons", "voxelwise"),
    *("failures", "cases", "attribution", "spool"),
)
SECONDS = 300  # a mutant may loop forever
GUARDS = {"strict", "frozen", "slots", "eq", "assume_unique"}
SWAPS = {
    ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt, ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.In: ast.NotIn, ast.NotIn: ast.In, ast.And: ast.Or,
    ast.Or: ast.And,
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult,
    ast.FloorDiv: ast.Mult, ast.Pow: ast.Mult,
    ast.Mod: ast.Mult, ast.LShift: ast.RShift, ast.RShift: ast.LShift, ast.BitOr: ast.BitAnd,
    ast.BitAnd: ast.BitOr,
}  # fmt: skip
PROFILE = {
    "deadline": None,
    "database": None,
    "derandomize": True,
    "phases": tuple(hypothesis.Phase)[:3],
}
FLAGS = (
    *("-xq", "-mnot slow", "-pno:cacheprovider", "-Wignore::pytest.PytestAssertRewriteWarning"),
    "--hypothesis-profile=mutants",
)


def changes(node: ast.AST) -> Iterator[tuple[str, str, object]]:
    """Kind, field and new value of each change of one node."""
    match node:
        case ast.Compare(ops=[op]):
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
        case ast.If(test=test) | ast.IfExp(test=test):
            yield "condition", "test", ast.UnaryOp(ast.Not(), test)
    block = node.body if isinstance(node, ast.FunctionDef | ast.If | ast.For | ast.While) else []
    for i, statement in enumerate(block):
        call = isinstance(statement, ast.Expr) and not isinstance(statement.value, ast.Constant)
        stored = isinstance(statement, ast.Assign) and not isinstance(
            statement.targets[0], ast.Name | ast.Tuple
        )
        if call or stored or isinstance(statement, ast.AugAssign | ast.Continue):
            yield (
                "statement",
                "body",
                [*block[:i], ast.copy_location(ast.Pass(), statement), *block[i + 1 :]],
            )


def mutants(tree: ast.Module) -> Iterator[tuple[str, ast.Module]]:
    """Kind and tree of every mutant."""
    parts = list(ast.walk(tree))
    aside = [n.value for n in parts if isinstance(n, ast.keyword) and n.arg in GUARDS]
    aside += [
        t for n in parts for t in (getattr(n, "annotation", None), getattr(n, "returns", None)) if t
    ]
    never = {part for each in aside for part in ast.walk(each)}
    for number, node in enumerate(parts):
        for kind, field, value in () if node in never else changes(node):
            mutant = deepcopy(tree)
            setattr(list(ast.walk(mutant))[number], field, deepcopy(value))
            yield kind, ast.fix_missing_locations(mutant)


class Mutated(SourceFileLoader):
    """Finds and loads one module, with the code of a mutant."""

    def __init__(self, path: Path, mutant: ast.Module) -> None:
        self.code = compile(mutant, str(path), "exec")
        package = (
            path.relative_to(ROOT)
            .with_suffix("")
            .parts[path.relative_to(ROOT).parts[0] != "dynaviz" :]
        )
        super().__init__(".".join(package).removesuffix(".__init__"), str(path))

    def find_spec(self, name: str, *_: object) -> ModuleSpec | None:
        return spec_from_file_location(name, self.path, loader=self) if name == self.name else None

    def exec_module(self, module: ModuleType) -> None:
        exec(self.code, vars(module))


def suite(path: Path) -> Path:
    """The folder of the tests of a module."""
    package, *rest = path.relative_to(ROOT).parts
    return TESTS / (rest[0] if package == "dynaviz" else package)


def survives(path: Path, mutant: ast.Module) -> bool:
    """Whether all tests of its suite pass with a mutant in place of a module."""
    if child := os.fork():
        return os.waitpid(child, 0)[1] == 0
    failed = 1
    try:
        signal.alarm(SECONDS)
        silence = os.open(os.devnull, os.O_WRONLY)
        os.dup2(silence, 1), os.dup2(silence, 2)
        sys.meta_path.insert(0, Mutated(path, mutant))
        own = sorted(suite(path).glob(f"test_{path.stem}.py"))
        aside = {*own, TESTS / "eval/test_report.py", TESTS / "eval/test_published.py"}
        failed = pytest.main(
            [*FLAGS, *map(str, (*own, *sorted(set(suite(path).glob("test_*.py")) - aside)))]
        )
    finally:
        os._exit(int(failed))


def main() -> None:
    """Try all mutants, or a sample, and print the survivors."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    metrics = [ROOT / f"eval/dynaviz_eval/{name}.py" for name in METRICS]
    parser.add_argument("paths", nargs="*", default=metrics, metavar="PATH", type=Path)
    parser.add_argument(
        "--sample",
        type=int,
        default=sys.maxsize,
        metavar="N",
        help="try at most N mutants per path",
    )
    options = parser.parse_args()
    hypothesis.settings.register_profile("mutants", **PROFILE)
    for given in map(Path.absolute, options.paths):
        trees = {
            path: ast.parse(path.read_text())
            for path in sorted(given.rglob("*.py") if given.is_dir() else [given])
        }
        some, tree = next(iter(trees.items()))
        if not survives(some, tree):
            sys.exit(f"{given.stem}: its tests fail without a mutant. Fix them first.")
        every = [(path, *each) for path, tree in trees.items() for each in mutants(tree)]
        tried, killed = collections.Counter[str](), collections.Counter[str]()
        chosen = sorted(random.Random(0).sample(range(len(every)), min(options.sample, len(every))))
        for path, kind, mutant in (every[i] for i in chosen):
            tried[kind] += 1
            killed[kind] += not (left := survives(path, mutant))
            if left:
                pairs = zip(
                    *(ast.unparse(each).splitlines() for each in (trees[path], mutant)),
                    strict=False,
                )
                print(
                    f"{path.stem}: {kind}",
                    *next(p for p in pairs if p[0] != p[1]),
                    sep="\n    ",
                    flush=True,
                )
        by_kind = ", ".join(
            f"{kind} {killed[kind]} of {count}" for kind, count in sorted(tried.items())
        )
        what = (
            f"{given.stem}: {killed.total()} of {tried.total()} killed by tests/{suite(some).name}"
        )
        print(f"{what} ({by_kind}); {len(every)} in total", flush=True)


if __name__ == "__main__":
    main()
