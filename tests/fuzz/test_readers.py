"""Readers of damaged files return complete data or refuse the file in one line; they never crash or hang.

By default each reader sees a few damaged files; ``FUZZ=2000 pytest tests/fuzz -k poses`` tries more. A file that makes
a reader fail is kept in the folder of the test.
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

DEFAULT_EXAMPLES = 5  # damaged files per reader
EXAMPLES = int(os.environ.get("FUZZ", DEFAULT_EXAMPLES))
TIMEOUT = 30  # seconds per file


class Timeout(BaseException):
    """A reader took too long; not an Exception, so that readers do not catch it."""


@contextmanager
def time_limit(seconds: int) -> Iterator[None]:
    def ring(number: int, frame: FrameType | None) -> None:
        raise Timeout(f"reading took more than {seconds} s")

    before = signal.signal(signal.SIGALRM, ring)
    signal.alarm(seconds)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


def reads_or_refuses(read: Callable[[Path], Any], path: Path, folder: Path) -> bool:
    """Whether the file was read; fails unless the reader succeeds or raises a readable error."""
    refusal = None
    with warnings.catch_warnings(record=True) as caught, time_limit(TIMEOUT):
        warnings.simplefilter("always")
        try:
            read(path)
        except DynavizError as error:
            refusal = error
        except Exception as error:  # shown in short form, because the text may be very long
            places = [f"{Path(at.filename).name}:{at.lineno}" for at in traceback.extract_tb(error.__traceback__)]
            raise AssertionError(f"{type(error).__name__}: {str(error)[:200]} at {' '.join(places)}") from None
    unexpected = [str(warning.message) for warning in caught if warning.category is not UserWarning]
    assert not unexpected, f"warned: {unexpected}"
    if refusal:
        assert str(refusal).isprintable(), f"not one printable line: {str(refusal)!r}"
        assert len(str(refusal)) < 2500, f"{len(str(refusal))} characters: {str(refusal)[:200]}"
        assert not isinstance(refusal, DataError) or Path(refusal.path).is_relative_to(folder), refusal
    return refusal is None


@pytest.fixture
def example(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    """A valid example in ``tmp_path``."""
    return SUBJECTS[request.param].make(tmp_path)


@pytest.mark.parametrize(("name", "example"), [(name, name) for name in SUBJECTS], indirect=["example"], ids=SUBJECTS)
def test_damaged_files_are_read_or_refused(name: str, example: Path, tmp_path: Path) -> None:
    subject = SUBJECTS[name]
    assert reads_or_refuses(subject.read, example, tmp_path), "the example itself is refused"
    contents = {file: file.read_bytes() for file in parts(tmp_path, subject.target)}
    # One file of each kind first, so that a single table is damaged as often as one of many sweeps.
    choices = [*{(file.parent, file.suffix): file for file in contents}.values(), *contents]
    damaged_files: list[Path] = []

    @settings(
        max_examples=EXAMPLES,
        derandomize=EXAMPLES == DEFAULT_EXAMPLES,
        database=None,
        phases=[Phase.generate] if EXAMPLES == DEFAULT_EXAMPLES else [Phase.generate, Phase.shrink],
        suppress_health_check=list(HealthCheck),
    )
    @given(st.sampled_from(choices), st.sampled_from(["damaged"] * 20 + ["missing", "empty", "a folder"]), st.data())
    def try_one(file: Path, state: str, data: st.DataObject) -> None:
        while damaged_files:  # restored here, so that a file that makes the reader fail is kept
            remove(damaged_files[-1])
            damaged_files[-1].write_bytes(contents[damaged_files.pop()])
        content = data.draw(damaged(contents[file])) if state == "damaged" else b""
        damaged_files.append(file)
        remove(file)
        if state == "a folder":
            file.mkdir()
        elif state != "missing":
            file.write_bytes(content)
        reads_or_refuses(subject.read, example, tmp_path)

    try_one()


def test_every_data_set_has_an_example() -> None:
    names = {handle.name for handle in registry.handles("datasets") if handle.distribution == "dynaviz"}
    assert set(DATASETS) == names - {"implant"}  # it has no files of its own
