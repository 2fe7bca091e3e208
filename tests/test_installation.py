"""What has to be installed.

Cleaning and viewing without heavy packages, and instructions that can be followed.
"""

from __future__ import annotations

import re
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest
from helpers.worlds import room

from dynaviz.contracts import registry
from dynaviz.contracts.registry import BEST
from dynaviz.precompile import quick_to_compile
from dynaviz.spatial import geometry

ROOT = Path(__file__).resolve().parents[1]
HEAVY = ("open3d", "matplotlib", "jinja2")
NOTEBOOK = (
    "IPython",
    "dash",
    "dask",
    "distributed",
    "ipywidgets",
    "jupyter_core",
    "nbformat",
    "pandas",
    "sklearn",
)
WITHOUT = f"""
import sys

class Blocked:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {(*HEAVY, *NOTEBOOK)!r}:
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)

sys.meta_path.insert(0, Blocked())
"""


def python(code: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)


@pytest.mark.slow
def test_cleaning_running_and_viewing_need_no_heavy_packages(tmp_path: Path) -> None:
    """A sequence is cleaned inside a polygon, a run recorded, read and explored, while their
    imports fail.
    """
    scans = tmp_path / "scans"
    scans.mkdir()
    world = room(frames=4, rays=1500).scans
    for scan in world:
        np.save(
            scans / f"{scan.index:06d}.npy",
            geometry.transform(geometry.inverse(scan.T_world_sensor), scan.points),
        )
    np.savetxt(scans / "poses.txt", [scan.T_world_sensor[:3].ravel() for scan in world])
    np.savetxt(tmp_path / "corners.txt", [[-9, -9], [9, -9], [0, 9]], delimiter=",")
    method, out = ("-m", "octomap", "--threads", 1), tmp_path / "out"
    lines: list[tuple[object, ...]] = [
        (
            "clean",
            scans,
            "-o",
            tmp_path / "map.laz",
            *method,
            "--region",
            tmp_path / "corners.txt",
            "--accept",
        ),
        ("run", "octomap", scans, "-o", out),
        ("info", out / "run.rrd"),
        ("doctor", scans),
        ("view", "--help"),
        ("explore", "--help"),
    ]
    typed = [["dynaviz", *map(str, words)] for words in lines]
    done = python(f"""{WITHOUT}
from dynaviz.cli import main
for sys.argv in {typed!r}:
    try:
        main()
    except SystemExit as end:
        if end.code and sys.argv[1] != "doctor":
            raise
import dynaviz.explorer.server, dynaviz.views.viewer, dynaviz.views.read.shot
import dynaviz.explorer.run
""")
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "map.laz").is_file()


@pytest.mark.parametrize("command", ["clean", "run", "view", "explore"])
def test_commands_start_without_heavy_packages(command: str) -> None:
    done = python(f"""
import sys
from dynaviz.cli import main
sys.argv = ["dynaviz", {command!r}, "--help"]
try:
    main()
except SystemExit:
    print(sorted({{name.partition(".")[0] for name in sys.modules}} & set({(*HEAVY, *NOTEBOOK)!r})))
""")
    assert done.stdout.splitlines()[-1] == "[]", done.stdout + done.stderr


def test_the_requirements_of_cleaning_are_those_of_the_package() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    extras = project["optional-dependencies"]
    wanted = [*project["dependencies"], *extras["las"], *extras["odometry"], *extras["ros"]]
    lines = (ROOT / "requirements-clean.txt").read_text().splitlines()
    listed = [line for line in lines if line and not line.startswith("#")]
    assert listed == [each for each in wanted if not each.startswith(HEAVY)]


TEXTS = [
    path
    for pattern in (
        "*.md",
        "docs/**/*.md",
        "eval/**/*.md",
        "dynaviz/**/*.py",
        "eval/**/*.py",
        "examples/**/*",
    )
    for path in ROOT.glob(pattern)
    if path.is_file() and path.suffix in (".md", ".py", ".toml", ".yml")
]


def test_no_instruction_installs_dynaviz_from_a_package_index() -> None:
    wrong = re.compile(r"pip install[^#\n]*[ '\"]dynaviz(?![-\w/.])|PyPI")
    found = {str(path.relative_to(ROOT)) for path in TEXTS if wrong.search(path.read_text())}
    assert found == set()


NUMBERS = {8: "eight", 9: "nine", 10: "ten", 11: "eleven", 12: "twelve", 13: "thirteen"}
METHODS = registry.loadable("methods")
IN_THE_DEMO = list(quick_to_compile())


@pytest.mark.parametrize(
    ("page", "pattern", "methods"),
    [
        ("README.md", r"one of (\w+) methods", METHODS),
        ("docs/index.md", r"(\w+) published methods", [name for name in METHODS if name != BEST]),
        ("README.md", r"run (\w+) methods,", IN_THE_DEMO),
        ("docs/index.md", r"run (\w+) methods", IN_THE_DEMO),
        ("docs/tutorial.md", r"[Rr]uns? (\w+) methods", IN_THE_DEMO),
    ],
)
def test_pages_state_the_number_of_methods(page: str, pattern: str, methods: list[str]) -> None:
    stated = re.findall(pattern, (ROOT / page).read_text())
    assert {word.lower() for word in stated} == {NUMBERS[len(methods)]}
