"""A headless viewer in tests; they skip if the machine has no graphics adapter."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator
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
    """The timeline of the recording in view, and the time on it.

    Waits until they are as expected.
    """

    def opened() -> tuple[Any, Any]:
        state = client.get_state()
        (active,) = [r for r in state.recordings if r.store_id == state.active_recording]
        return active.current_timeline, active.current_time

    return _awaited(opened, lambda found: found == expected)


def problems(recording: Path, client: ViewerClient) -> dict[Any, Any]:
    """Show a recording; problems the viewer reports, by view, once all data have arrived."""
    push(recording, client)
    return _awaited(
        lambda: {view.name: view.reports for view in client.get_state().views},
        lambda shown: not any(shown.values()),
    )


def _awaited(read: Callable[[], Any], done: Callable[[Any], bool]) -> Any:
    """What the viewer shows, read again and again until it is as it should be, or for 30 s."""
    end = time.monotonic() + 30
    while True:
        found = read()
        if done(found) or time.monotonic() > end:
            return found
        time.sleep(0.2)
