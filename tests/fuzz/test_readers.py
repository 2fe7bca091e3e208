"""Whatever a file holds, its reader gives something whole or refuses it in one line; it never fails otherwise or hangs.

``FUZZ=2000 pytest tests/fuzz -k poses`` tries more than the few accidents of every day. What a reader fails on stays in
the test's folder.
"""

from __future__ import annotations

import os
import signal
import traceback
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import Any

import pytest
from helpers.damage import damaged, remove
from helpers.readable_files import DATASETS, SUBJECTS, parts
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

from dynaviz import registry
from dynaviz.errors import DataError, DynavizError

FEW = 5  # accidents a reader every day
EXAMPLES = int(os.environ.get("FUZZ", FEW))
PATIENCE = 30  # seconds


class Hang(BaseException):
    """Not an error that a reader may take for its own."""


@contextmanager
def patience(seconds: int) -> Iterator[None]:
    def ring(number: int, frame: FrameType | None) -> None:
        raise Hang(f"it read for {seconds} s")

    before = signal.signal(signal.SIGALRM, ring)
    signal.alarm(seconds)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


def reads_or_refuses(read: Callable[[Path], Any], path: Path, folder: Path) -> bool:
    """Whether it was read; fails for anything but a refusal that a user understands."""
    refusal = None
    with warnings.catch_warnings(record=True) as said, patience(PATIENCE):
        warnings.simplefilter("always")
        try:
            read(path)
        except DynavizError as error:
            refusal = error
        except Exception as error:  # some cannot be shown: their texts are long, their lines of code are no code
            places = [f"{Path(at.filename).name}:{at.lineno}" for at in traceback.extract_tb(error.__traceback__)]
            raise AssertionError(f"{type(error).__name__}: {str(error)[:200]} at {' '.join(places)}") from None
    odd = [str(warning.message) for warning in said if warning.category is not UserWarning]
    assert not odd, f"warned: {odd}"
    if refusal:
        assert str(refusal).isprintable(), f"not one plain line: {str(refusal)!r}"
        assert len(str(refusal)) < 2500, f"{len(str(refusal))} characters: {str(refusal)[:200]}"
        assert not isinstance(refusal, DataError) or Path(refusal.path).is_relative_to(folder), refusal
    return refusal is None


@pytest.fixture
def example(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    """A valid example in ``tmp_path``."""
    make = SUBJECTS[request.param].make
    return request.getfixturevalue(make) if isinstance(make, str) else make(tmp_path)


@pytest.mark.parametrize(("name", "example"), [(name, name) for name in SUBJECTS], indirect=["example"], ids=SUBJECTS)
def test_damaged_files_are_read_or_refused(name: str, example: Path, tmp_path: Path) -> None:
    subject = SUBJECTS[name]
    assert reads_or_refuses(subject.read, example, tmp_path), "the example itself is refused"
    whole = {file: file.read_bytes() for file in parts(tmp_path, subject.target)}
    # As often the one table as one of many sweeps.
    choices = [*{(file.parent, file.suffix): file for file in whole}.values(), *whole]
    hurt: list[Path] = []

    @settings(
        max_examples=EXAMPLES,
        derandomize=EXAMPLES == FEW,
        database=None,
        phases=[Phase.generate] if EXAMPLES == FEW else [Phase.generate, Phase.shrink],
        suppress_health_check=list(HealthCheck),
    )
    @given(st.sampled_from(choices), st.sampled_from(["damaged"] * 20 + ["absent", "empty", "a folder"]), st.data())
    def try_one(file: Path, fate: str, data: st.DataObject) -> None:
        while hurt:  # mended here, so that what a reader failed on stays
            remove(hurt[-1])
            hurt[-1].write_bytes(whole[hurt.pop()])
        content = data.draw(damaged(whole[file])) if fate == "damaged" else b""
        hurt.append(file)
        remove(file)
        if fate == "a folder":
            file.mkdir()
        elif fate != "absent":
            file.write_bytes(content)
        reads_or_refuses(subject.read, example, tmp_path)

    try_one()


def test_every_data_set_is_tried() -> None:
    ours = {handle.name for handle in registry.handles("datasets") if handle.distribution == "dynaviz"}
    assert set(DATASETS) == ours
