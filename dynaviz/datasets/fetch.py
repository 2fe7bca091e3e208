"""Fetching one large file over HTTP from where the last attempt stopped."""

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

TRIES, PAUSE, PATIENCE = 4, 1.0, 60.0  # attempts without a new byte; seconds before the second; seconds of silence
HINT = "Run the same command again later, or give another place that has the file with --url"
_BLOCK, _MB = 1 << 18, 1_000_000


def fetch(url: str, part: Path, tell: Callable[[int, int], None], mb: int = 0) -> None:
    """Bring a file to its full length, from where it ends.

    Args:
        url: http or https.
        part: the file, of which a first piece may be there.
        tell: called with megabytes done and in total.
        mb: the total where the server does not tell.

    Raises:
        DataError: where the server does not have it, or breaks off ``TRIES`` times without a new byte.
        OSError: where the file cannot be written.

    Nobody asks of what file the first piece is: whoever calls compares a checksum.
    """
    tries, best = 0, _size(part)
    while True:
        try:
            return _attempt(url, part, tell, mb)
        except _BrokenDownload as broken:
            tries = 1 if _size(part) > best else tries + 1
            best = max(best, _size(part))
            if tries == TRIES:
                kept = f"after {best / _MB:,.1f} MB, which are kept" if _size(part) else "before its first byte"
                raise DataError(url, f"breaks off {kept} ({broken})", hint=HINT) from None
        time.sleep(PAUSE * 2 ** (tries - 1))


class _BrokenDownload(Exception):
    """The connection ended before the file did; another attempt may help."""


def _attempt(url: str, part: Path, tell: Callable[[int, int], None], mb: int) -> None:
    """One request for what is missing."""
    have = _size(part)
    reply = _ask(url, part, have)
    if reply is None:
        return
    with reply:
        if reply.headers.get_content_type() == "text/html":  # a gateway's or an archive's way to say no
            raise DataError(url, "is a web page, not a file", hint="Look there with a browser")
        start, total = _span(reply, have)
        with open(part, "r+b" if have else "wb") as file:
            file.seek(start)
            file.truncate()  # the server may have begun anew
            done = said = start
            for block in _blocks(reply):
                file.write(block)
                done += len(block)
                if done // _MB > said // _MB:
                    said = done
                    tell(done // _MB, max(done // _MB, mb if total is None else total // _MB))
    if total is not None and done < total:
        raise _BrokenDownload(f"{done:,} of {total:,} bytes came")
    if not done:
        raise _BrokenDownload("nothing came")


def _ask(url: str, part: Path, have: int) -> Any:
    """The reply to a request from byte ``have`` on; None where nothing is missing."""
    headers = {"User-Agent": "dynaviz", "Accept-Encoding": "identity"} | ({"Range": f"bytes={have}-"} if have else {})
    try:
        return urllib.request.urlopen(urllib.request.Request(url, headers=headers), timeout=PATIENCE)
    except urllib.error.HTTPError as error:
        with error:
            code, reason, span = error.code, error.reason, error.headers.get("Content-Range", "")
        if code == 416 and span.endswith(f"/{have}"):
            return None
        if code == 416:  # what is there is longer than the file
            remove(part)
        if code in (408, 416, 429) or code >= 500:
            raise _BrokenDownload(f"{code} {reason}") from None
        hint = "Look there with a browser, or give another place that has the file with --url"
        raise DataError(url, f"cannot be fetched ({code} {reason})", hint=hint) from None
    except (OSError, http.client.HTTPException, ValueError) as error:
        cause = getattr(error, "reason", error)
        why = getattr(cause, "strerror", None) or str(cause) or type(cause).__name__
        if isinstance(cause, socket.gaierror | ValueError):
            hint = "Look at your connection and the address; --url gives another place that has the file"
            raise DataError(url, f"cannot be reached ({why})", hint=hint) from None
        raise _BrokenDownload(why) from None


def _span(reply: Any, have: int) -> tuple[int, int | None]:
    """At which byte a reply begins, and how long the file is, if the server tells."""
    if reply.status == 206:
        span = re.match(r"bytes (\d+)-\d+/(\d+)", reply.headers.get("Content-Range", ""))
        if span is None or int(span[1]) > have:
            raise _BrokenDownload("the server sent another piece than the one asked for")
        return int(span[1]), int(span[2])
    length = reply.headers.get("Content-Length", "")
    return 0, int(length) if length.isdigit() else None


def _blocks(reply: Any) -> Iterator[bytes]:
    """What comes, until it ends or breaks."""
    while True:
        try:
            block = reply.read(_BLOCK)
        except (OSError, http.client.HTTPException) as error:
            raise _BrokenDownload(getattr(error, "strerror", None) or type(error).__name__) from None
        if not block:
            return
        yield block


def _size(path: Path) -> int:
    return path.stat().st_size if path.exists() else 0
