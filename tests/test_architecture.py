"""The arrows between packages, and what a quick command may import."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from collections import Counter
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

from dynaviz.contracts import registry

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = {
    "dynaviz": ROOT / "dynaviz",
    "dynaviz_methods": ROOT / "methods/dynaviz_methods",
    "dynaviz_eval": ROOT / "eval/dynaviz_eval",
}


@cache
def imports(path: Path) -> tuple[str, ...]:
    """Modules and names that a file imports, also inside functions."""
    found: list[str] = []
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            found += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            found += [node.module, *(f"{node.module}.{alias.name}" for alias in node.names)]
    return tuple(found)


def files(package: str) -> list[Path]:
    return sorted(PACKAGES[package].rglob("*.py"))


@cache
def paths() -> dict[str, Path]:
    """The file of each module."""
    return {
        ".".join((package, *path.relative_to(root).with_suffix("").parts)).removesuffix(
            ".__init__"
        ): path
        for package, root in PACKAGES.items()
        for path in files(package)
    }


@cache
def modules() -> dict[str, set[str]]:
    """Each module with the modules that it imports, also inside functions and for types only."""
    names = paths()
    return {
        name: {known for known in imports(path) if known in names and known != name}
        for name, path in names.items()
    }


def without_packages(found: set[str]) -> set[str]:
    """``from a import b`` imports module a.b where there is one, not what else is in a."""
    return {name for name in found if not any(other.startswith(name + ".") for other in found)}


def test_no_module_imports_itself_in_a_circle() -> None:
    graph = {
        name: without_packages(found)
        for name, found in modules().items()
        if not name.endswith("__main__")
    }
    graph["dynaviz"] = set()  # it only looks names up for users
    TopologicalSorter(graph).prepare()  # raises CycleError with the circle


def test_no_package_imports_itself_in_a_circle() -> None:
    def room(name: str) -> str:
        return (
            ".".join(name.split(".")[:2]) if name.startswith("dynaviz.") else name.partition(".")[0]
        )

    graph: dict[str, set[str]] = {}
    for name, found in modules().items():
        if name != "dynaviz":
            graph.setdefault(room(name), set()).update(
                room(other) for other in without_packages(found) - {"dynaviz"}
            )
    TopologicalSorter({name: found - {name} for name, found in graph.items()}).prepare()


def test_imports_go_down_in_the_drawing_of_the_house() -> None:
    drawing = (ROOT / "CONTRIBUTING.md").read_text().partition("```text\n")[2].partition("```")[0]
    rows = [re.split(r"   +", line)[0].split("  ") for line in drawing.splitlines()]
    floor = {name.strip().rstrip("/"): -row for row, names in enumerate(rows) for name in names}
    rooms = {
        path.stem
        for path in (ROOT / "dynaviz").iterdir()
        if path.suffix == ".py" or (path / "__init__.py").exists()
    }
    entrances = {
        "__init__",
        "__main__",
        "precompile",
        "colours",
    }  # they start programs, or are used everywhere
    assert rooms - entrances <= floor.keys()
    for name, found in modules().items():
        above = floor.get(name.split(".")[1] if "." in name else "")
        if name.startswith("dynaviz.") and above is not None:
            for other in without_packages(found) - {"dynaviz"}:
                below = (
                    floor.get(other.split(".")[1], above) if other.startswith("dynaviz.") else above
                )
                assert below <= above, f"{name} imports {other}"


def test_a_name_has_one_meaning() -> None:
    """No public class name is used twice, and no file name twice in one room."""
    classes = Counter(
        node.name
        for package in PACKAGES
        for path in files(package)
        for node in ast.parse(path.read_text()).body
        if isinstance(node, ast.ClassDef) and not node.name.startswith("_")
    )
    assert [name for name, count in classes.items() if count > 1] == []
    names = Counter(
        (package, path.relative_to(PACKAGES[package]).parts[0], path.name)
        for package in PACKAGES
        for path in files(package)
        if not path.name.startswith("__")
    )
    assert [name for name, count in names.items() if count > 1] == []


def test_the_top_has_few_loose_modules() -> None:
    assert len(list((ROOT / "dynaviz").glob("*.py"))) <= 12


def within(name: str, *modules: str) -> bool:
    return any(name == module or name.startswith(module + ".") for module in modules)


def test_the_core_names_no_method_and_no_metric() -> None:
    plugged = "dynaviz_methods", "dynaviz_eval"
    assert [
        path for path in files("dynaviz") if any(within(name, *plugged) for name in imports(path))
    ] == []


EXAMPLE = "an example in an error"
NAMED = {  # names of methods in the core, apart from examples in docstrings
    "dynaviz/contracts/registry.py": "the method if a user names none",
    "dynaviz/synthetic/implants/panel.toml": "the methods that vote, which differ in principle",
    "dynaviz/benchmarking/plan_file.py": EXAMPLE,
}


def texts(path: Path) -> str:
    """The strings of a file without its docstrings; the content of a file that is not Python."""
    text = path.read_text()
    if path.suffix != ".py":
        return text
    tree = ast.parse(text)
    documents = {
        id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)
    }  # docstrings, also of constants
    strings = [
        node.value
        for node in ast.walk(tree)
        if isinstance(node, ast.Constant)
        and isinstance(node.value, str)
        and id(node) not in documents
    ]
    names = [node.id for node in ast.walk(tree) if isinstance(node, ast.Name)]
    return "\n".join((*strings, *names))


def test_the_core_names_no_method() -> None:
    """What it shows of a method comes from the method: its colour, presets and measurements."""
    handles = [each for each in registry.handles("methods") if each.distribution == "dynaviz"]
    words = {each.name for each in handles} | {each.load().info.title for each in handles}
    assert len(words) > 20
    pattern = re.compile(rf"(?<![\w-])({'|'.join(map(re.escape, words))})(?![\w-])")
    found = {
        str(path.relative_to(ROOT))
        for path in (ROOT / "dynaviz").rglob("*")
        if path.suffix in {".py", ".toml", ".json", ".html", ".js", ".css"}
        and pattern.search(texts(path))
    }
    assert found == set(NAMED)


def test_only_viz_imports_rerun() -> None:
    guilty = {
        p
        for package in PACKAGES
        for p in files(package)
        if any(within(n, "rerun") for n in imports(p))
    }
    assert guilty
    assert all(path.is_relative_to(ROOT / "dynaviz/views") for path in guilty)


def decorators(path: Path) -> dict[str, str]:
    """The decorators of each function of a file."""
    return {
        node.name: " ".join(map(ast.unparse, node.decorator_list))
        for node in ast.parse(path.read_text()).body
        if isinstance(node, ast.FunctionDef)
    }


def test_no_file_imports_a_parallel_kernel() -> None:
    """Where numba's threading layer serves one thread, only ``kernels.FILE.function`` waits."""
    parallel = {
        f"{module}.{name}"
        for module, path in paths().items()
        for name, decorator in decorators(path).items()
        if "parallel=True" in decorator
    }
    assert len(parallel) > 10
    assert [path for path in paths().values() if parallel & set(imports(path))] == []


def test_kernels_are_loaded_on_first_use() -> None:
    """Only other kernels import a file with kernels: they share its functions."""
    kernels = {
        module
        for module, path in paths().items()
        if any("njit" in decorator for decorator in decorators(path).values())
    }
    assert len(kernels) > 20
    assert all(".kernels." in module for module in kernels)
    assert [
        module
        for module, path in paths().items()
        if kernels & set(imports(path)) and ".kernels." not in module
    ] == []


METHODS_MAY = ("arrays", "contracts", "spatial", "blocks", "kernels", "errors")
EVAL_MAY = (*METHODS_MAY, "colours", "scores", "reports", "io")


@pytest.mark.parametrize(
    ("package", "allowed"), [("dynaviz_methods", METHODS_MAY), ("dynaviz_eval", EVAL_MAY)]
)
def test_plug_ins_use_only_the_contracts(package: str, allowed: tuple[str, ...]) -> None:
    for path in files(package):
        for name in imports(path):
            if within(name, "dynaviz") and name != "dynaviz":
                assert within(name, *(f"dynaviz.{module}" for module in allowed)), f"{path}: {name}"


def test_no_generic_name_is_ever_installed() -> None:
    assert not [
        folder
        for folder in ("methods", "eval", "recordings")
        if (ROOT / folder / "__init__.py").exists()
    ]


COMMANDS = (
    *(
        [name, "--help"]
        for name in ("run", "score", "bench", "compare", "doctor", "convert", "report")
    ),
    *(["--help"], ["list"], ["list", "methods"], ["list", "octomap_gf"]),
)
QUICK = """
import sys
from dynaviz.cli import main
heavy = {"open3d", "cv2", "rerun", "numba", "scipy", "pyarrow", "matplotlib", "jinja2", "PIL"}
heavy |= {"distributed", "optuna"}
for command in COMMANDS:
    sys.argv = ["dynaviz", *command]
    try:
        main()
    except SystemExit as end:
        assert not end.code, (command, end.code)
    if loaded := heavy & set(sys.modules):
        sys.exit(f"{command} loaded {loaded}")
"""


def test_quick_commands_load_nothing_heavy() -> None:
    code = QUICK.replace("COMMANDS", repr(COMMANDS))
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def is_parallel(node: ast.AST) -> bool:
    """``a, b = x, y``; not a swap, nor any other values that need what the targets were before."""
    match node:
        case ast.Assign(targets=[ast.Tuple(elts=targets)], value=ast.Tuple(elts=values)):
            if any(isinstance(each, ast.Starred) for each in (*targets, *values)):
                return False
            assigned = {ast.unparse(target) for target in targets}
            read = {
                ast.unparse(part)
                for value in values
                for part in ast.walk(value)
                if isinstance(part, ast.expr)
            }
            return not assigned & read
    return False


def test_a_line_assigns_one_thing() -> None:
    found = [
        f"{path.relative_to(ROOT)}:{node.lineno}"
        for package in PACKAGES
        for path in files(package)
        for node in ast.walk(ast.parse(path.read_text()))
        if is_parallel(node)
    ]
    assert found == []


def test_parallel_assignments_are_recognised() -> None:
    parallel = "a, b = x, y", "a, b = 0, 0", "self.a, self.b = a, b", "a[0], a[1] = x, y"
    others = "a, b = b, a", "a, b = pair", "a, b = c * a, s * a", "a = b, c", "a, *b = x, y"
    assert [is_parallel(ast.parse(each).body[0]) for each in parallel] == [True] * len(parallel)
    assert [is_parallel(ast.parse(each).body[0]) for each in others] == [False] * len(others)


def test_no_file_has_grown_too_long() -> None:
    lines = {
        str(p.relative_to(ROOT)): len(p.read_text().splitlines())
        for package in PACKAGES
        for p in files(package)
    }
    assert {name: count for name, count in lines.items() if count > 600} == {}
