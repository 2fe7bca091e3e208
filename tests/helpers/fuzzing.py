"""Read damaged files and check that each is read or refused: ``python -m helpers.fuzzing NAME...

[-n 10000] [-s 1]``.

As a program it reads them in child processes, so that it reports crashes, hangs and memory, too;
run it in ``tests``.
"""

from __future__ import annotations

import argparse
import contextlib
import faulthandler
import math
import os
import resource
import shutil
import signal
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from random import Random
from types import FrameType
from typing import Any

from dynaviz.errors import DataError, DynavizError
from helpers.damage import remove
from helpers.read_once import read_once
from helpers.readable_commands import COMMANDS
from helpers.readable_files import SUBJECTS, parts
from helpers.structured_damage import damaged_structure

EVERYTHING = SUBJECTS | COMMANDS
TIMEOUT = 30  # seconds per file
MEMORY = 200 << 20  # bytes that a reader may need in addition
BATCH = 2500  # files per child process
CRASHED = 70  # exit code of a child process that fails itself


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
    """Whether the file was read.

    Fails unless the reader succeeds, returns False, or raises a readable error.
    """
    refusal, read_it = None, True
    with warnings.catch_warnings(record=True) as caught, time_limit(TIMEOUT):
        warnings.simplefilter("always")
        try:
            read_it = read(path) is not False
        except DynavizError as error:
            refusal = error
        except Exception as error:  # shown in short form, because the text may be very long
            places = [
                f"{Path(at.filename).name}:{at.lineno}"
                for at in traceback.extract_tb(error.__traceback__)
            ]
            raise AssertionError(
                f"{type(error).__name__}: {str(error)[:200]} at {' '.join(places)}"
            ) from None
    unexpected = [str(warning.message) for warning in caught if warning.category is not UserWarning]
    assert not unexpected, f"warned: {unexpected}"
    if refusal:
        assert str(refusal).isprintable(), f"not one printable line: {str(refusal)!r}"
        assert len(str(refusal)) < 2500, f"{len(str(refusal))} characters: {str(refusal)[:200]}"
        assert not isinstance(refusal, DataError) or Path(refusal.path).is_relative_to(folder), (
            refusal
        )
    return refusal is None and read_it


class Mutants:
    """The damaged files of a subject.

    Args:
        name: of the subject.
        folder: an empty folder, for the example and its damaged copies.
    """

    def __init__(self, name: str, folder: Path) -> None:
        self.subject, self.folder = EVERYTHING[name], folder
        self.example = self.subject.make(folder)
        self.contents = {file: file.read_bytes() for file in parts(folder, self.subject.target)}
        # One file of each kind first, so that a single table is damaged as often as one of many
        # sweeps.
        kinds = {(file.parent, file.suffix): file for file in self.contents}
        self.choices = [*kinds.values(), *self.contents]

    def read(self, seed: int) -> bool:
        """Damage a file, and read the example; whether it was read.

        A file that makes the reader fail is kept.
        """
        random = Random(seed)
        file = random.choice(self.choices)
        content = damaged_structure(file, self.contents[file], random)
        remove(file)
        file.write_bytes(content)
        read = reads_or_refuses(self.subject.read, self.example, self.folder)
        self.restore(file)
        return read

    def restore(self, *files: Path) -> None:
        """Undo the damage to some files; default: all."""
        for file in files or self.contents:
            remove(file)
            file.write_bytes(self.contents[file])


def main() -> None:
    """Fuzz subjects; print a line for each, and one for each failure.

    Exits with 1 if there is one.
    """
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "names",
        nargs="*",
        default=list(SUBJECTS),
        help="of readers or commands; default: all readers",
    )
    parser.add_argument("-n", type=int, default=1000, help="number of files per subject")
    parser.add_argument(
        "-s", type=int, default=int(os.environ.get("FUZZ_SEED", "1")), help="first seed"
    )
    parser.add_argument(
        "-j", type=int, default=1, help="number of processes, each with its share of the subjects"
    )
    parser.add_argument(
        "--seconds", type=float, default=math.inf, help="time limit of all subjects together"
    )
    options = parser.parse_args()
    end = time.monotonic() + options.seconds
    read_once()
    jobs = []
    for first in range(options.j):
        jobs.append(os.fork())
        if not jobs[-1]:
            names = options.names[first :: options.j][::-1]  # the fast ones are at the end
            seeds = range(options.s, options.s + options.n)
            # Each subject has an equal share of the time that is left, so that slow ones use what
            # fast ones leave.
            failed = sum(
                fuzz(name, seeds, _share(end, len(names) - k)) for k, name in enumerate(names)
            )
            os._exit(failed > 0)
    sys.exit(max(os.waitstatus_to_exitcode(os.waitpid(job, 0)[1]) for job in jobs))


def _share(end: float, subjects: int) -> float:
    return time.monotonic() + (end - time.monotonic()) / subjects


def fuzz(name: str, seeds: range, until: float) -> int:
    """Read the damaged files of a subject in child processes and print the outcomes.

    Returns the number of failures.
    """
    start, counts, most, done = time.monotonic(), Counter[str](), 0, 0
    while done < len(seeds) and time.monotonic() < until:
        for outcome, memory in batch(name, seeds[done : done + BATCH], until):
            failed = outcome not in ("read", "refused") or memory > MEMORY
            if failed:
                print(f"{name}, seed {seeds[done]}, {memory >> 20} MB: {outcome[:500]}", flush=True)
            counts["failed" if failed else outcome] += 1
            most, done = max(most, memory), done + 1
    files = ", ".join(f"{count:,} {outcome}" for outcome, count in sorted(counts.items()))
    took = time.monotonic() - start
    print(
        f"{name}: {files}; at most {most >> 20} MB; {took:.0f} s, {done / took:.0f} per second",
        flush=True,
    )
    return counts["failed"]


def batch(name: str, seeds: range, until: float) -> Iterator[tuple[str, int]]:
    """Outcome and additional bytes of memory per seed, read in a child process.

    Ends at the first crash or hang.
    """
    receive, send = os.pipe()
    with tempfile.TemporaryDirectory() as folder:
        child = os.fork()
        if not child:
            os.close(receive)
            os.dup2(os.open(f"{folder}/stderr.txt", os.O_WRONLY | os.O_CREAT), 2)
            try:
                with os.fdopen(send, "w") as out:
                    read_all(name, Path(folder, "example"), seeds, until, out)
            finally:
                os._exit(0 if not sys.exc_info()[0] else CRASHED)
        os.close(send)
        with os.fdopen(receive) as lines:
            ready = lines.readline()
            for line in lines:
                memory, outcome = line.rstrip("\n").split(" ", 1)
                yield outcome, int(memory)
        status = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
        messages = Path(folder, "stderr.txt").read_text(errors="replace")[-300:]
        assert ready, f"{name}: the example cannot be read: {messages}"
        if status:
            kept = shutil.copytree(folder, tempfile.mkdtemp(prefix="crash-"), dirs_exist_ok=True)
            problem = (
                f"the process ended with {status}"
                if status != 1
                else f"no answer after {2 * TIMEOUT} s"
            )
            yield f"{problem}: {' '.join(messages.split())}; the files are kept in {kept}", 0


def read_all(name: str, folder: Path, seeds: range, until: float, out: Any) -> None:
    """Runs in the child process; prints a line when it is ready, and one after each file."""
    folder.mkdir()
    mutants = Mutants(name, folder)
    assert reads_or_refuses(
        mutants.subject.read, mutants.example, folder
    )  # loads all libraries, too
    print("ready", file=out, flush=True)
    for seed in seeds:
        if time.monotonic() > until:
            break
        faulthandler.dump_traceback_later(
            2 * TIMEOUT, exit=True
        )  # ends hangs in compiled code, too
        before = memory(reset=True)
        try:
            outcome = "read" if mutants.read(seed) else "refused"
        except (AssertionError, Timeout) as error:
            outcome = " ".join(str(error).split())
            mutants.restore()
        print(memory() - before, outcome, file=out, flush=True)


def memory(reset: bool = False) -> int:
    """Bytes that this process has used at most, since the last reset if the system can forget what
    was before.
    """
    with contextlib.suppress(OSError):
        if reset:
            Path("/proc/self/clear_refs").write_text("5")
        status = Path("/proc/self/status").read_text()
        return int(status.partition("VmHWM:")[2].split()[0]) << 10
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss << 10


if __name__ == "__main__":
    main()
