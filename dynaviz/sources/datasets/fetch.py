"""Download a large file over HTTP, resuming where the last attempt stopped."""

from __future__ import annotations

import http.client
import re
import socket
import time
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from dynaviz.errors import DataError
from dynaviz.io.atomic import remove

MAX_ATTEMPTS = 4  # without a new byte
RETRY_DELAY = 1.0  # seconds before the second attempt, doubled for each further one
TIMEOUT = 60.0  # seconds without data
HINT = "Run the same command again later, or set DYNAVIZ_DOWNLOAD_URL to a mirror"
_BLOCK = 1 << 18
_MB = 1_000_000


def fetch(url: str, part: Path, progress: Callable[[int, int], None], mb: int = 0) -> None:
    """Download a file, or the rest of it if a first part exists.

    The first part is not verified; callers must compare a checksum.

    Args:
        url: http or https.
        part: the local file, which may contain the first part.
        progress: called with the megabytes done and the total.
        mb: the total, used if the server does not send it.

    Raises:
        DataError: if the server does not have the file, or ``MAX_ATTEMPTS`` attempts in a row bring
            no new byte.
        OSError: if the file cannot be written.
    """
    attempts = 0
    received = _size(part)
    while True:
        try:
            return _attempt(url, part, progress, mb)
        except _BrokenDownload as broken:
            attempts = 1 if _size(part) > received else attempts + 1
            received = max(received, _size(part))
            if attempts == MAX_ATTEMPTS:
                kept = (
                    f"after {received / _MB:,.1f} MB, which are kept"
                    if _size(part)
                    else "before the first byte"
                )
                raise DataError(url, f"download stopped {kept} ({broken})", hint=HINT) from None
        time.sleep(RETRY_DELAY * 2 ** (attempts - 1))


class _BrokenDownload(Exception):
    """The connection ended before the file was complete; another attempt may help."""


def _attempt(url: str, part: Path, progress: Callable[[int, int], None], mb: int) -> None:
    """Request and write the missing part once."""
    have = _size(part)
    reply = _request(url, part, have)
    if reply is None:
        return
    with reply:
        if (
            reply.headers.get_content_type() == "text/html"
        ):  # how gateways and archives report errors
            raise DataError(
                url,
                "the server sent a web page, not the file",
                hint="Open the address in a browser",
            )
        start, total = _content_range(reply, have)
        with open(part, "r+b" if have else "wb") as file:
            file.seek(start)
            file.truncate()  # the server may have restarted from the beginning
            done = reported = start
            for block in _read_blocks(reply):
                file.write(block)
                done += len(block)
                if done // _MB > reported // _MB:
                    reported = done
                    progress(done // _MB, max(done // _MB, mb if total is None else total // _MB))
    if total is not None and done < total:
        raise _BrokenDownload(f"received {done:,} of {total:,} bytes")
    if not done:
        raise _BrokenDownload("received nothing")


def _request(url: str, part: Path, have: int) -> Any:
    """The reply to a request from byte ``have`` on; None if the file is complete."""
    headers = {"User-Agent": "dynaviz", "Accept-Encoding": "identity"} | (
        {"Range": f"bytes={have}-"} if have else {}
    )
    try:
        return urllib.request.urlopen(urllib.request.Request(url, headers=headers), timeout=TIMEOUT)
    except urllib.error.HTTPError as error:
        with error:
            code = error.code
            reason = error.reason
            span = error.headers.get("Content-Range", "")
        if code == 416 and span.endswith(f"/{have}"):
            return None
        if code == 416:  # the local part is longer than the file
            remove(part)
        if code in (408, 416, 429) or code >= 500:
            raise _BrokenDownload(f"{code} {reason}") from None
        hint = "Open the address in a browser, or set DYNAVIZ_DOWNLOAD_URL to a mirror"
        raise DataError(url, f"download failed ({code} {reason})", hint=hint) from None
    except (OSError, http.client.HTTPException, ValueError) as error:
        cause = getattr(error, "reason", error)
        reason = getattr(cause, "strerror", None) or str(cause) or type(cause).__name__
        if isinstance(cause, socket.gaierror | ValueError):
            hint = "Check your connection and the address, or set DYNAVIZ_DOWNLOAD_URL to a mirror"
            raise DataError(url, f"cannot connect ({reason})", hint=hint) from None
        raise _BrokenDownload(reason) from None


def _content_range(reply: Any, have: int) -> tuple[int, int | None]:
    """First byte of a reply, and size of the file if the server sends it."""
    if reply.status == 206:
        span = re.match(r"bytes (\d+)-\d+/(\d+)", reply.headers.get("Content-Range", ""))
        if span is None or int(span[1]) > have:
            raise _BrokenDownload("the server sent a different range than requested")
        return int(span[1]), int(span[2])
    length = reply.headers.get("Content-Length", "")
    return 0, int(length) if length.isdigit() else None


def _read_blocks(reply: Any) -> Iterator[bytes]:
    """The blocks of a reply, until it ends or the connection breaks."""
    while True:
        try:
            block = reply.read(_BLOCK)
        except (OSError, http.client.HTTPException) as error:
            raise _BrokenDownload(
                getattr(error, "strerror", None) or type(error).__name__
            ) from None
        if not block:
            return
        yield block


def _size(path: Path) -> int:
    return path.stat().st_size if path.exists() else 0
