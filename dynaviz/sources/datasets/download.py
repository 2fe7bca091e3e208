"""Download the sequences of the public benchmark: fetch, verify and unpack them atomically."""

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
from functools import partial
from pathlib import Path, PurePosixPath
from typing import IO, Any

from dynaviz.errors import DataError, UsageError
from dynaviz.io.atomic import atomic_folder, remove
from dynaviz.progress import Progress, silent
from dynaviz.sources.datasets.fetch import HINT, TIMEOUT, fetch

BASE = "https://zenodo.org/records/10886629/files"
_BLOCK = 1 << 18
_MACOS_FILES = re.compile(r"__MACOSX/|(.*/)?\._")  # metadata that macOS adds to archives


@dataclass(frozen=True)
class RemoteFile:
    """A sequence that can be downloaded.

    Attributes:
        title: short description.
        mb: size of the archive in megabytes.
        frames: number of frames.
        sensor: name of the sensor in dynaviz; None if dynaviz does not have it.
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
    "av2": RemoteFile("Argoverse 2, a log in a large city", 1300, 575, "vlp32c_pair"),
    "semindoor": RemoteFile("a hall that is open on one side", 621, 960, "vlp16"),
    "twofloor": RemoteFile("two floors, one pedestrian", 725, 3305, "mid360", labelled=False),
    "kthcampus": RemoteFile("a campus, scanned from a tripod", 256, 18, None, labelled=False),
}


def download(
    name: str,
    out: str | os.PathLike[str],
    base: str = BASE,
    progress: Progress = silent,
) -> Path:
    """Fetch, verify and unpack a sequence.

    An interrupted download is kept in ``.NAME.zip.part`` and resumed by the next attempt. Size and
    MD5 are checked against the Zenodo record.

    Args:
        name: one of ``SEQUENCES``.
        out: folder in which the folder ``NAME`` is created; ``NAME`` must not exist yet.
        base: http or https address of the folder that contains ``NAME.zip``.
        progress: called with the phase, the megabytes or files done, and the total.

    Returns:
        The folder of the sequence.

    Raises:
        UsageError: for an unknown name or an invalid address.
        DataError: if the archive cannot be fetched or written, or is corrupt.
    """
    if name not in SEQUENCES:
        available = ", ".join(f"{key} ({remote.mb} MB)" for key, remote in SEQUENCES.items())
        raise UsageError(f"unknown sequence '{name}'. Available: {available}")
    if not re.match(r"https?://[^/]", base):
        raise UsageError(
            f"DYNAVIZ_DOWNLOAD_URL={base}: give the address of a folder that contains {name}.zip, "
            f"such as {BASE}"
        )
    out = Path(out)
    url = f"{base.rstrip('/')}/{name}.zip"
    folder = out / name
    part = out / f".{name}.zip.part"
    if os.path.lexists(folder):
        raise DataError(
            folder, "already exists", hint="Use it, remove it, or choose another folder"
        )
    published = _published_facts(base, name)
    try:
        out.mkdir(parents=True, exist_ok=True)
        fetch(url, part, lambda done, total: progress("fetch", done, total), SEQUENCES[name].mb)
    except BaseException as error:
        if part.exists() and not isinstance(error, Exception):
            error.add_note(
                f"The partial download is kept in {part}. Run the same command to resume"
            )
        if isinstance(error, OSError):
            hint = "Free disk space or choose another folder"
            raise DataError(out, f"cannot be written ({error.strerror})", hint=hint) from None
        raise
    _verify(url, part, published, base)
    _unpack(url, part, folder, SEQUENCES[name], lambda done, total: progress("unpack", done, total))
    remove(part)
    return folder


def _published_facts(base: str, name: str) -> dict[str, Any]:
    """Size and MD5 of the archive in the Zenodo record; empty if there is no record."""
    match = re.match(r"(https?://[^/]+)/records/(\d+)/files", base)
    if match is None:
        return {}
    request = urllib.request.Request(
        f"{match[1]}/api/records/{match[2]}", headers={"User-Agent": "dynaviz"}
    )
    try:
        with urllib.request.urlopen(request, timeout=TIMEOUT) as reply:
            files = {file["key"]: file for file in json.load(reply)["files"]}
        file = files[f"{name}.zip"]
        return {"size": int(file["size"]), "md5": str(file["checksum"]).removeprefix("md5:")}
    except (OSError, http.client.HTTPException, ValueError, KeyError, TypeError):
        return {}  # the zip archive has checksums of its own


def _verify(url: str, part: Path, published: Mapping[str, Any], base: str) -> None:
    """Compare size and MD5 of an archive with the published ones, and remove an archive that
    differs.

    Raises:
        DataError: if they differ.
    """
    if not published:
        return
    md5 = partial(hashlib.md5, usedforsecurity=False)
    with open(part, "rb") as file:
        facts = {"size": part.stat().st_size, "md5": hashlib.file_digest(file, md5).hexdigest()}
    for key, value in published.items():
        if facts[key] != value:
            remove(part)
            problem = f"{key} mismatch: got {facts[key]}, but the record at {base} has {value}"
            raise DataError(url, problem, hint=f"The file was removed. {HINT}")


def _unpack(
    url: str, part: Path, folder: Path, remote: RemoteFile, progress: Callable[[int, int], None]
) -> None:
    """Unpack ``pcd`` and the files next to it from an archive into the folder of the sequence.

    Raises:
        DataError: if the archive is corrupt, has no scans or unsafe paths, or needs more space than
            is free.
    """
    with _zip_errors(url, part), zipfile.ZipFile(part) as archive:
        members = [
            info
            for info in archive.infolist()
            if not (info.is_dir() or _MACOS_FILES.match(info.filename))
        ]
        for info in members:
            if PurePosixPath(info.filename).is_absolute() or {"..", ""} & set(
                re.split(r"[/\\]", info.filename)
            ):
                raise DataError(
                    url, f"unsafe path {info.filename!r} in the archive", hint=f"Remove {part}"
                )
        scans = (re.match(r"((?:.*/)?)pcd/[^/]+\.pcd$", info.filename) for info in members)
        first = next((scan for scan in scans if scan), None)
        if first is None:
            raise DataError(
                url,
                "the archive contains no pcd/*.pcd",
                hint=f"Inspect the archive and remove {part}",
            )
        root = first[1]
        needed = sum(info.file_size for info in members)
        free = shutil.disk_usage(part.parent).free
        if needed > free:
            problem = f"needs {needed / 1e9:.1f} GB unpacked, but {free / 1e9:.1f} GB are free"
            raise DataError(
                folder, problem, hint="Free disk space and run again; the archive is kept"
            )
        with atomic_folder(folder) as temporary:
            for done, info in enumerate(members, 1):
                if info.filename.startswith(root):
                    target = temporary / info.filename.removeprefix(root)
                    target.parent.mkdir(parents=True, exist_ok=True)
                    with archive.open(info) as source, open(target, "wb") as file:
                        shutil.copyfileobj(source, file, _BLOCK)
                progress(done, len(members))
            facts = temporary / "sequence.toml"
            if remote.sensor and not facts.exists():
                facts.write_text(f'sensor = "{remote.sensor}"\n')


@contextlib.contextmanager
def _zip_errors(url: str, part: Path) -> Iterator[None]:
    """Turn the errors that zipfile raises for corrupt archives into DataError, and remove the
    archive.
    """
    try:
        yield
    except (
        zipfile.BadZipFile,
        zlib.error,
        EOFError,
        NotImplementedError,
        RuntimeError,
        ValueError,
    ) as error:
        with open(part, "rb") as file:
            head = _describe_head(file)
        remove(part)
        problem = (
            f"truncated or corrupt zip archive ({str(error)[:80] or type(error).__name__}{head})"
        )
        raise DataError(url, problem, hint=f"The file was removed. {HINT}") from None


def _describe_head(file: IO[bytes]) -> str:
    """The first bytes of a file that is not an archive.

    Often it is a page with an error message.
    """
    head = file.read(40)
    return "" if head.startswith(b"PK") else f"; it starts with {head.decode('latin-1')!r}"
