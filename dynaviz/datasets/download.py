"""The public benchmark's own sequences: fetched, checked, and unpacked whole or not at all."""

from __future__ import annotations

import contextlib
import hashlib
import http.client
import json
import os
import re
import shutil
import urllib.request
import zipfile
import zlib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import IO, Any

from dynaviz.datasets.fetch import HINT, PATIENCE, fetch
from dynaviz.errors import DataError, UsageError
from dynaviz.io.atomic import atomic_folder, remove, write_atomic
from dynaviz.progress import Progress, silent

BASE = "https://zenodo.org/records/10886629/files"
_BLOCK = 1 << 18
_MAC = re.compile(r"__MACOSX/|(.*/)?\._")  # what a Mac adds to an archive


@dataclass(frozen=True)
class RemoteFile:
    """A sequence that can be had.

    Attributes:
        title: what it is.
        mb: size of its archive.
        frames: how many.
        sensor: by dynaviz's name; None where it has none.
        labelled: whether there is ground truth.
    """

    title: str
    mb: int
    frames: int
    sensor: str | None
    labelled: bool = True


SEQUENCES: Mapping[str, RemoteFile] = {
    "00": RemoteFile("KITTI 00, frames 4390 to 4530", 385, 141, "hdl64e"),
    "05": RemoteFile("KITTI 05, frames 2350 to 2670", 864, 321, "hdl64e"),
    "av2": RemoteFile("Argoverse 2, a log in a big city", 1300, 575, "vlp32c_pair"),
    "semindoor": RemoteFile("a hall that is open to one side", 621, 960, "vlp16"),
    "twofloor": RemoteFile("two floors, one pedestrian", 725, 3305, "mid360", labelled=False),
    "kthcampus": RemoteFile("a campus, by a scanner on a tripod", 256, 18, None, labelled=False),
}


def download(
    name: str,
    out: str | os.PathLike[str],
    base: str = BASE,
    progress: Progress = silent,
) -> Path:
    """Fetch and unpack a sequence.

    What a connection that breaks leaves in ``.NAME.zip.part`` is used by the next attempt. Size and MD5 are those that
    the Zenodo record tells; ``NAME.download.json`` beside the sequence keeps them with the SHA-256, and the next
    download of that name must agree with it.

    Args:
        name: one of ``SEQUENCES``.
        out: folder in which the folder ``NAME`` is made, which must not exist yet.
        base: where ``NAME.zip`` is: http or https.
        progress: called with a phase, and how many megabytes or files of how many are done.

    Returns:
        The folder of the sequence.

    Raises:
        UsageError: for a name that is not known, or a base that is no address.
        DataError: for what cannot be fetched or written, or is damaged.
    """
    if name not in SEQUENCES:
        known = ", ".join(f"{key} ({remote.mb} MB)" for key, remote in SEQUENCES.items())
        raise UsageError(f"no sequence '{name}' to download. Known: {known}")
    if not re.match(r"https?://[^/]", base):
        raise UsageError(f"--url {base}: give the address of a folder with {name}.zip, as {BASE}")
    out, url = Path(out), f"{base.rstrip('/')}/{name}.zip"
    folder, part, record = out / name, out / f".{name}.zip.part", out / f"{name}.download.json"
    if os.path.lexists(folder):
        raise DataError(folder, "exists already", hint="Use it, remove it, or choose another folder with -o")
    before, told = _recorded(record), _told(base, name)
    try:
        out.mkdir(parents=True, exist_ok=True)
        fetch(url, part, lambda done, total: progress("fetching, MB", done, total), SEQUENCES[name].mb)
    except BaseException as error:
        if part.exists() and not isinstance(error, Exception):
            error.add_note(f"{part} has what was fetched; the same command goes on from there")
        if isinstance(error, OSError):
            hint = "Free space or choose another folder with -o"
            raise DataError(out, f"cannot be written ({error.strerror})", hint=hint) from None
        raise
    facts = {"url": url, "size": part.stat().st_size, **_digests(part)}
    _compare(url, part, facts, told, f"the record at {base}", f"It was removed. {HINT}", spoilt=True)
    _compare(url, part, facts, before, record.name, f"Remove {record} if you trust the new one, and run again")
    _unpack(url, part, folder, SEQUENCES[name], lambda done, total: progress("unpacking, files", done, total))
    write_atomic(record, json.dumps(facts | {"told": told}, indent=2).encode() + b"\n")
    remove(part)
    return folder


def _told(base: str, name: str) -> dict[str, Any]:
    """Size and MD5 of the archive as the Zenodo record tells them; nothing where there is no such record."""
    match = re.match(r"(https?://[^/]+)/records/(\d+)/files", base)
    if match is None:
        return {}
    request = urllib.request.Request(f"{match[1]}/api/records/{match[2]}", headers={"User-Agent": "dynaviz"})
    try:
        with urllib.request.urlopen(request, timeout=PATIENCE) as reply:
            files = {file["key"]: file for file in json.load(reply)["files"]}
        file = files[f"{name}.zip"]
        return {"size": int(file["size"]), "md5": str(file["checksum"]).removeprefix("md5:")}
    except (OSError, http.client.HTTPException, ValueError, KeyError, TypeError):
        return {}  # the archive checks itself, too


def _recorded(record: Path) -> dict[str, Any]:
    """What an earlier download noted."""
    try:
        facts = json.loads(record.read_bytes())
        return {key: facts[key] for key in ("size", "sha256")}
    except (FileNotFoundError, NotADirectoryError):
        return {}
    except (OSError, ValueError, KeyError, TypeError):
        raise DataError(record, "is no record of a download", hint="Remove it and run again") from None


def _digests(part: Path) -> dict[str, str]:
    """SHA-256 and MD5, in one reading."""
    kinds = {"sha256": hashlib.sha256(), "md5": hashlib.md5(usedforsecurity=False)}
    with open(part, "rb") as file:
        while block := file.read(_BLOCK):
            for kind in kinds.values():
                kind.update(block)
    return {name: kind.hexdigest() for name, kind in kinds.items()}


def _compare(
    url: str, part: Path, facts: Mapping[str, Any], due: Mapping[str, Any], by: str, hint: str, spoilt: bool = False
) -> None:
    """Refuse an archive that is another one than it should be; one that is spoilt does not stay."""
    for key, value in due.items():
        if facts[key] != value:
            if spoilt:
                remove(part)
            raise DataError(url, f"has {key} {facts[key]}, where {by} tells {value}", hint=hint)


def _unpack(url: str, part: Path, folder: Path, remote: RemoteFile, tell: Callable[[int, int], None]) -> None:
    """Make the sequence's folder from an archive; only what lies beside ``pcd`` is taken.

    Raises:
        DataError: for an archive that is damaged, holds no scans, leaves its folder, or needs more space than there is.
    """
    with _whole(url, part), zipfile.ZipFile(part) as archive:
        members = [info for info in archive.infolist() if not (info.is_dir() or _MAC.match(info.filename))]
        for info in members:
            if PurePosixPath(info.filename).is_absolute() or {"..", ""} & set(re.split(r"[/\\]", info.filename)):
                raise DataError(url, f"holds {info.filename!r}, which leaves its folder", hint=f"Remove {part}")
        scans = (re.match(r"((?:.*/)?)pcd/[^/]+\.pcd$", info.filename) for info in members)
        first = next((scan for scan in scans if scan), None)
        if first is None:
            raise DataError(url, "holds no pcd/*.pcd", hint=f"Remove {part}, and look at the archive")
        root = first[1]
        needed, free = sum(info.file_size for info in members), shutil.disk_usage(part.parent).free
        if needed > free:
            problem = f"needs {needed / 1e9:.1f} GB unpacked, but {free / 1e9:.1f} GB are free"
            raise DataError(folder, problem, hint="Free space and run again: the archive is kept")
        with atomic_folder(folder) as beside:
            for done, info in enumerate(members, 1):
                if info.filename.startswith(root):
                    target = beside / info.filename.removeprefix(root)
                    target.parent.mkdir(parents=True, exist_ok=True)
                    with archive.open(info) as source, open(target, "wb") as file:
                        shutil.copyfileobj(source, file, _BLOCK)
                tell(done, len(members))
            facts = beside / "sequence.toml"
            if remote.sensor and not facts.exists():
                facts.write_text(f'sensor = "{remote.sensor}"\n')


@contextlib.contextmanager
def _whole(url: str, part: Path) -> Iterator[None]:
    """What a damaged archive makes zipfile raise, told alike; such an archive does not stay."""
    try:
        yield
    except (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, RuntimeError, ValueError) as error:
        with open(part, "rb") as file:
            begins = _glance(file)
        remove(part)
        what = f"is no whole zip archive ({str(error)[:80] or type(error).__name__}{begins})"
        raise DataError(url, what, hint=f"It was removed. {HINT}") from None


def _glance(file: IO[bytes]) -> str:
    """How a file begins that is no archive: often it is a page that says why."""
    head = file.read(40)
    return "" if head.startswith(b"PK") else f"; it begins with {head.decode('latin-1')!r}"
