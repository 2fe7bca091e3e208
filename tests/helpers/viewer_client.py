"""A headless viewer in tests; they skip if the machine has no graphics adapter."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from rerun.experimental import ViewerClient

from dynaviz.errors import MissingDependency
from dynaviz.views import viewer
from dynaviz.views.read.shot import push


@contextlib.contextmanager
def headless(size: tuple[int, int]) -> Iterator[ViewerClient]:
    """A viewer without a window."""
    with contextlib.ExitStack() as stack:
        try:
            client = stack.enter_context(viewer.headless(size))
        except MissingDependency as missing:
            pytest.skip(str(missing))
        yield client


def opened_at(client: ViewerClient, expected: tuple[str, int]) -> tuple[Any, Any]:
    """The timeline of the recording in view, and the time on it; waits up to 30 s until they are as expected."""
    end = time.monotonic() + 30
    while True:
        state = client.get_state()
        (opened,) = [r for r in state.recordings if r.store_id == state.active_recording]
        found = opened.current_timeline, opened.current_time
        if found == expected or time.monotonic() > end:
            return found
        time.sleep(0.2)


def problems(recording: Path, client: ViewerClient) -> dict[Any, Any]:
    """Show a recording; problems the viewer reports, by view, once all data have arrived."""
    push(recording, client)
    end = time.monotonic() + 30
    while True:
        shown = {view.name: view.reports for view in client.get_state().views}
        if not any(shown.values()) or time.monotonic() > end:
            return shown
        time.sleep(0.2)
