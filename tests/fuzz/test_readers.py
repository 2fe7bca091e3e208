"""Readers of damaged files return complete data or refuse the file in one line.

They never crash or hang.

By default each reader sees a few damaged files; ``FUZZ=2000 pytest tests/fuzz -k poses`` tries
more. A file that makes a reader fail is kept in the folder of the test. ``helpers/fuzzing.py``
reads many in child processes.
"""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from helpers.damage import damaged, remove
from helpers.fuzzing import Mutants, reads_or_refuses
from helpers.readable_commands import COMMANDS
from helpers.readable_files import DATASETS, SUBJECTS
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

from dynaviz.cli import app
from dynaviz.contracts import registry

DEFAULT_EXAMPLES = 5  # damaged files per reader
# a second or more per file
SLOW = (
    "dynaviz tune (with the search)",
    "dynaviz report (HTML, drawn)",
    "dynaviz bench",
)
EXAMPLES = int(os.environ.get("FUZZ", DEFAULT_EXAMPLES))


@pytest.mark.parametrize("name", SUBJECTS)
def test_damaged_files_are_read_or_refused(name: str, tmp_path: Path) -> None:
    mutants = Mutants(name, tmp_path)
    assert reads_or_refuses(mutants.subject.read, mutants.example, tmp_path), (
        "the example itself is refused"
    )
    contents = mutants.contents
    damaged_files: list[Path] = []

    @settings(
        max_examples=EXAMPLES,
        derandomize=EXAMPLES == DEFAULT_EXAMPLES,
        database=None,
        phases=[Phase.generate] if EXAMPLES == DEFAULT_EXAMPLES else [Phase.generate, Phase.shrink],
        suppress_health_check=list(HealthCheck),
    )
    @given(
        st.sampled_from(mutants.choices),
        st.sampled_from(["damaged"] * 20 + ["missing", "empty", "a folder"]),
        st.data(),
    )
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
        reads_or_refuses(mutants.subject.read, mutants.example, tmp_path)

    try_one()
    for file in damaged_files:
        remove(file)
        file.write_bytes(contents[file])
    for seed in range(EXAMPLES):
        mutants.read(seed)


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in COMMANDS if name not in SLOW])
def test_commands_read_or_refuse_damaged_files(name: str, tmp_path: Path) -> None:
    mutants = Mutants(name, tmp_path)
    assert reads_or_refuses(mutants.subject.read, mutants.example, tmp_path), (
        "the example itself is refused"
    )
    for seed in range(EXAMPLES // 2):
        mutants.read(seed)


def test_every_command_that_reads_files_has_an_example() -> None:
    """The others read no files of the user: they simulate."""
    names = {command.name for command in app.registered_commands}
    assert {name.split()[1] for name in COMMANDS} == names - {"demo"}


def test_every_data_set_has_an_example() -> None:
    names = {
        handle.name for handle in registry.handles("datasets") if handle.distribution == "dynaviz"
    }
    assert set(DATASETS) == names - {
        "implant",
        "simulate",
        "merged",
    }  # no files of their own; SUBJECTS has the last
