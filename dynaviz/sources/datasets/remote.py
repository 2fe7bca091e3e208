"""Sequences at URLs that fsspec reads.

Files are fetched when they are needed, and kept in a folder of this machine.

Each process fetches for itself, so workers of a cluster read the frames of their tiles only.
"""

from __future__ import annotations

import hashlib
import os
from pathlib import Path

from dynaviz.arrays import F32, F64
from dynaviz.contracts.attributes import Attributes
from dynaviz.contracts.scan import Scan
from dynaviz.errors import DataError, MissingDependency
from dynaviz.io.atomic import atomic_file
from dynaviz.sources.datasets.benchmark import BenchmarkSequence
from dynaviz.sources.derived import Derived
from dynaviz.sources.drive import Drive

CACHE = "DYNAVIZ_CACHE"
"""Environment variable: the folder for fetched files; by default ``~/.cache/dynaviz``."""
_HINT = "Give the URL of a folder with pcd/*.pcd"
_TRUTH = "gt_cloud.pcd"
_FACTS = "sequence.toml"


class RemoteSequence(Derived):
    """A folder in the layout of the public benchmark at a URL.

    A scan is fetched when it is read; with ground truth, all scans are fetched when the sequence is
    opened, because ``gt_cloud.pcd`` is divided by their numbers of points.

    Raises:
        MissingDependency: if fsspec, or its package for this kind of URL, is not installed.
        DataError: if the URL cannot be read, or has no scans.
    """

    def __init__(self, url: str) -> None:
        self.url = url.rstrip("/")
        try:
            import fsspec  # type: ignore[import-untyped]

            self._files, self._root = fsspec.url_to_fs(self.url)
        except ImportError as error:
            raise MissingDependency(
                f"{url}: needs a package that is not installed ({error}). "
                "Install the one for HTTP with: pip install 'fsspec[http]'"
            ) from None
        except ValueError as error:
            raise DataError(url, f"is not a URL that can be read ({error})", hint=_HINT) from None
        home = Path(os.environ.get(CACHE) or Path.home() / ".cache" / "dynaviz")
        self._cache = (
            home
            / "remote"
            / hashlib.sha256(self.url.encode()).hexdigest()[:16]
            / self.url.rpartition("/")[2]
        )
        names = self._listed("pcd")
        others = self._listed("")
        scans = {
            int(name[:-4]): self._cache / "pcd" / name for name in names if name[:-4].isdigit()
        }
        if not scans:
            raise DataError(url, "has no pcd/*.pcd", hint=_HINT)
        for name in {_FACTS, _TRUTH} & set(others):
            self._fetch(self._cache / name)
        first = next(iter(sorted(scans)))
        for path in scans.values() if _TRUTH in others else [scans[first]]:
            self._fetch(path)
        opened = BenchmarkSequence.open(self._cache)
        self._scans: dict[int, Path] = dict(sorted(scans.items()))
        if _TRUTH not in others:
            opened = BenchmarkSequence(
                opened.name, opened.sensor, opened.rate, self._scans, None, opened.class_names
            )
        self.whole = Drive.of(opened)

    def __reduce__(self) -> tuple[type[RemoteSequence], tuple[str]]:
        return RemoteSequence, (self.url,)

    def __getitem__(self, position: int) -> Scan:
        self._fetch(list(self._scans.values())[position])
        return self.whole[position]

    def attributes(self, position: int) -> Attributes:
        """All fields of the file besides the coordinates."""
        self._fetch(list(self._scans.values())[position])
        return self.whole.attributes(position)

    def coordinates(self, position: int) -> F32 | F64 | None:
        """Those of the file."""
        self._fetch(list(self._scans.values())[position])
        return self.whole.coordinates(position)

    @property
    def format(self) -> str:
        """That of the folder."""
        return f"{self.whole.reader.format}, at a URL"

    def scan_file(self, index: int) -> Path | None:
        """The file of the frame with this number, on this machine."""
        if (path := self._scans.get(index)) is not None:
            self._fetch(path)
        return path

    def _listed(self, folder: str) -> list[str]:
        """Names of the files in a folder; empty if it does not exist."""
        try:
            found = self._files.ls(f"{self._root}/{folder}".rstrip("/") + "/", detail=False)
        except FileNotFoundError:
            return []
        except Exception as error:  # each file system has its own types
            raise DataError(self.url, f"cannot be listed ({error})", hint=_HINT) from None
        return [str(name).rstrip("/").rpartition("/")[2] for name in found]

    def _fetch(self, path: Path) -> None:
        """Fetch a file unless it is there."""
        if path.exists():
            return
        name = path.relative_to(self._cache).as_posix()
        with atomic_file(path) as part:
            try:
                self._files.get_file(f"{self._root}/{name}", str(part))
            except Exception as error:  # each file system has its own types
                raise DataError(
                    f"{self.url}/{name}", f"cannot be fetched ({error})", hint=_HINT
                ) from None
