"""Read damaged files and check that each is read or refused: ``python -m helpers.fuzzing NAME... [-n 10000] [-s 1]``.

As a program it reads them in child processes, so that it reports crashes, hangs and memory, too; run it in ``tests``.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import resource
import signal
import sys
import tempfile
import time
import traceback
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from random import Random
from types import FrameType
from typing import Any

from dynaviz.errors import DataError, DynavizError
from helpers.damage import remove
from helpers.readable_files import SUBJECTS, parts
from helpers.structured_damage import damaged_structure

TIMEOUT = 30  # seconds per file
MEMORY = 200 << 20  # bytes that a reader may need in addition to four times the size of the file
BATCH = 250  # files per child process


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


class Mutants:
    """The damaged files of a subject.

    Args:
        name: of the subject.
        folder: an empty folder, for the example and its damaged copies.
    """

    def __init__(self, name: str, folder: Path) -> None:
        self.subject, self.folder = SUBJECTS[name], folder
        self.example = self.subject.make(folder)
        self.contents = {file: file.read_bytes() for file in parts(folder, self.subject.target)}
        # One file of each kind first, so that a single table is damaged as often as one of many sweeps.
        kinds = {(file.parent, file.suffix): file for file in self.contents}
        self.choices = [*kinds.values(), *self.contents]

    def read(self, seed: int) -> bool:
        """Damage a file, and read the example; whether it was read. A file that makes the reader fail is kept."""
        random = Random(seed)
        file = random.choice(self.choices)
        content = damaged_structure(file, self.contents[file], random)
        remove(file)
        file.write_bytes(content)
        read = reads_or_refuses(self.subject.read, self.example, self.folder)
        remove(file)
        file.write_bytes(self.contents[file])
        return read


def main() -> None:
    """Fuzz subjects, and print a line for each, and one for each failure."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", default=list(SUBJECTS))
    parser.add_argument("-n", type=int, default=1000, help="number of files per subject")
    parser.add_argument("-s", type=int, default=1, help="first seed")
    options = parser.parse_args()
    for name in options.names or SUBJECTS:
        start, count, most = time.monotonic(), {"read": 0, "refused": 0, "failed": 0}, 0
        done, end = options.s, options.s + options.n
        while done < end:
            for seed, outcome, memory in batch(name, done, min(done + BATCH, end)):
                count[outcome if outcome in count else "failed"] += 1
                most, done = max(most, memory), seed + 1
                if outcome not in count or memory > MEMORY:
                    print(f"{name}, seed {seed}, {memory >> 20} MB: {outcome[:500]}", flush=True)
        print(f"{name}: {count}, at most {most >> 20} MB, {time.monotonic() - start:.0f} s", flush=True)


def batch(name: str, first: int, last: int) -> Iterator[tuple[int, str, int]]:
    """Seed, outcome and additional memory in bytes of each file, read in a child process; ends at the first crash."""
    receive, send = os.pipe()
    with tempfile.TemporaryDirectory() as folder:
        child = os.fork()
        if child == 0:
            os.close(receive)
            os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
            with os.fdopen(send, "w") as out:
                child_main(name, Path(folder), range(first, last), out)
            os._exit(0)
        os.close(send)
        seed = first - 1
        with os.fdopen(receive) as lines:
            for line in lines:
                number, memory, outcome = line.rstrip("\n").split(" ", 2)
                seed = int(number)
                yield seed, outcome, int(memory)
        _, status = os.waitpid(child, 0)
    if status:
        yield seed + 1, f"the process ended with {os.waitstatus_to_exitcode(status)}", 0


def child_main(name: str, folder: Path, seeds: range, out: Any) -> None:
    mutants = Mutants(name, folder)
    with contextlib.suppress(AssertionError):
        reads_or_refuses(mutants.subject.read, mutants.example, folder)  # loads all libraries
    for seed in seeds:
        before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        try:
            outcome = "read" if mutants.read(seed) else "refused"
        except (AssertionError, Timeout) as error:
            outcome = " ".join(str(error).split())
            for file, content in mutants.contents.items():
                remove(file)
                file.write_bytes(content)
        more = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
        out.write(f"{seed} {more << 10} {outcome}\n")
        out.flush()


if __name__ == "__main__":
    sys.exit(main())
