"""Methods from other packages, installed for real."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from helpers.installed_packages import python_with

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"
PROGRAMS = {  # of each method: the module of the public program, the package, and a parameter
    "dufomap_wheel": ("dufomap", "dufomap", "d_s=0.3"),
    "dor_wheel": ("dynamic_object_removal", "dynamic-object-removal", "free_votes_fraction=0.3"),
}
Code = Callable[..., str]


@pytest.fixture(scope="module", params=PROGRAMS)
def name(request: pytest.FixtureRequest) -> str:
    """The name of a method, and of the folder of its package."""
    return str(request.param)


@pytest.fixture(scope="module")
def python(name: str, tmp_path_factory: pytest.TempPathFactory) -> Code:
    """Run code with the example installed in addition to everything else."""
    call = python_with(EXAMPLES / name, tmp_path_factory.mktemp("site"))

    def run(code: str, *arguments: str) -> str:
        done = call("-c", code, *arguments)
        assert not done.returncode, done.stderr
        return done.stdout

    return run


def test_it_is_listed_and_configured_as_any_other(python: Code, name: str) -> None:
    main = "from dynaviz.cli import main; main()"
    assert f"dynaviz-{name.replace('_', '-')} 0.1.0" in python(main, "list", "methods")
    setting = PROGRAMS[name][2]
    parameter, _, value = setting.partition("=")
    row = next(
        line
        for line in python(main, "list", name, "--set", setting).splitlines()
        if parameter in line
    )
    assert value in row
    assert "--set" in row


def test_it_conforms(python: Code, name: str) -> None:
    module, package, _ = PROGRAMS[name]
    pytest.importorskip(module, reason=f"needs the public program: pip install {package}")
    python(
        "from dynaviz import testing; from dynaviz.contracts import registry; "
        f"testing.check_method(registry.load('methods', '{name}'))"
    )
