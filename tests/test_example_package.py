"""A method from another package, installed for real."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from helpers.installed_packages import python_with

EXAMPLE = Path(__file__).resolve().parents[1] / "examples/dufomap_wheel"
Code = Callable[..., str]


@pytest.fixture(scope="module")
def python(tmp_path_factory: pytest.TempPathFactory) -> Code:
    """Run code with the example installed in addition to everything else."""
    call = python_with(EXAMPLE, tmp_path_factory.mktemp("site"))

    def run(code: str, *arguments: str) -> str:
        done = call("-c", code, *arguments)
        assert not done.returncode, done.stderr
        return done.stdout

    return run


def test_it_is_listed_and_configured_as_any_other(python: Code) -> None:
    main = "from dynaviz.cli import main; main()"
    assert "dynaviz-dufomap-wheel 0.1.0" in python(main, "list", "methods")
    row = next(
        line
        for line in python(main, "list", "dufomap_wheel", "--set", "d_s=0.3").splitlines()
        if "d_s" in line
    )
    assert "0.3" in row
    assert "--set" in row


def test_it_conforms(python: Code) -> None:
    pytest.importorskip("dufomap", reason="needs the public program: pip install dufomap")
    python(
        "from dynaviz import registry, testing; testing.check_method(registry.load('methods', "
        "'dufomap_wheel'))"
    )
