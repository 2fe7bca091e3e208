"""The wheel: built, installed into an environment of its own, and used outside the checkout."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import sysconfig
import zipfile
from collections.abc import Callable
from pathlib import Path

import pytest
from helpers.toy_method import write_room

CHECKOUT = Path(__file__).resolve().parents[1]
Command = Callable[..., str]


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    pytest.importorskip("hatchling")
    folder = tmp_path_factory.mktemp("wheel")
    pip = [
        sys.executable,
        "-m",
        "pip",
        "wheel",
        "--quiet",
        "--disable-pip-version-check",
        "--no-deps",
    ]
    subprocess.run(
        [*pip, "--no-build-isolation", "--wheel-dir", folder, CHECKOUT],
        check=True,
        capture_output=True,
    )
    (built,) = folder.iterdir()
    return built


@pytest.fixture(scope="module")
def command(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Command:
    """Call a program of the environment in an empty folder.

    What the wheel needs is lent by the tests' environment.
    """
    home, away = tmp_path_factory.mktemp("venv"), tmp_path_factory.mktemp("away")
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", home], check=True)
    pip = [
        sys.executable,
        "-m",
        "pip",
        "--python",
        home / "bin/python",
        "install",
        "--quiet",
        "--no-deps",
    ]
    subprocess.run([*pip, "--disable-pip-version-check", wheel], check=True, capture_output=True)
    site = Path(sysconfig.get_path("purelib", vars={"base": str(home), "platbase": str(home)}))
    (site / "lent.pth").write_text(sysconfig.get_path("purelib"))
    environment = {
        name: value
        for name, value in os.environ.items()
        if not name.startswith(("PYTHON", "NUMBA"))
    }

    def call(program: str, *words: object, **variables: str) -> str:
        done = subprocess.run(
            [home / "bin" / program, *map(str, words)],
            cwd=away,
            env={**environment, **variables},
            capture_output=True,
            text=True,
            check=False,
        )
        assert not done.returncode, done.stderr
        return done.stdout + done.stderr

    return call


@pytest.mark.slow
def test_it_holds_the_three_packages_and_no_other(wheel: Path) -> None:
    names = zipfile.ZipFile(wheel).namelist()
    tops = {name.partition("/")[0] for name in names if ".dist-info/" not in name}
    assert tops == {"dynaviz", "dynaviz_methods", "dynaviz_eval"}
    assert {f"{top}/py.typed" for top in tops} <= set(names)
    assert any(name.endswith("licenses/LICENSE") for name in names)


@pytest.mark.slow
def test_ros_finds_the_package_in_it(wheel: Path) -> None:
    """What is installed for ROS 2, and where."""
    prefix = f"{wheel.name.rpartition('-py3')[0]}.data/data"
    content = zipfile.ZipFile(wheel)
    names = set(content.namelist())
    for name in (
        "share/ament_index/resource_index/packages/dynaviz",
        "share/dynaviz/package.xml",
        "share/dynaviz/launch/live.launch.py",
        "lib/dynaviz/live",
    ):
        assert f"{prefix}/{name}" in names
    executable = content.getinfo(f"{prefix}/lib/dynaviz/live")
    assert executable.external_attr >> 16 & 0o111
    version = wheel.name.split("-")[1]
    assert (
        f"<version>{version}</version>"
        in content.read(f"{prefix}/share/dynaviz/package.xml").decode()
    )


def test_it_runs_outside_the_checkout(command: Command, tmp_path: Path) -> None:
    where = command(
        "python",
        "-c",
        "import dynaviz, dynaviz_eval, dynaviz_methods as m; print(dynaviz.__file__, m)",
    )
    assert str(CHECKOUT) not in where
    listed = command("python", "-m", "dynaviz", "list")
    assert "cannot be loaded" not in listed
    assert all(
        name in listed
        for name in ("erasor", "hdl64e", "av2", "semantickitti", "street_vlp16", "confusion")
    )
    room = write_room(tmp_path / "room", frames=3, rays=400)
    # Compiling takes half a minute, and plain Python is fast enough for a small room. It warns when
    # integers overflow.
    uncompiled = {"NUMBA_DISABLE_JIT": "1", "PYTHONWARNINGS": "ignore::RuntimeWarning"}
    output = command(
        "dynaviz", "run", "erasor", room, "-o", "run", "--set", "sensor_height=1", **uncompiled
    )
    assert re.search(r"Open it with: \S*/bin/dynaviz view run/run.rrd$", output, re.MULTILINE), (
        output
    )
    assert "Warning" not in output
    assert " DA  Kept: " in command("dynaviz", "info", "run/run.rrd", "--failures", **uncompiled)
    command("dynaviz", "report", "run", "-o", "report.html", **uncompiled)


@pytest.mark.slow
def test_kernels_are_compiled_once(command: Command) -> None:
    pack = (
        "import numpy as np; from dynaviz.spatial.grid import pack; print(pack(np.ones((1, 3), "
        "np.float32), 0.5))"
    )
    first, again = (command("python", "-c", pack) for _ in range(2))
    assert "compiling kernels of dynaviz, kept for later" in first
    assert "compiling" not in again
    assert again in first
