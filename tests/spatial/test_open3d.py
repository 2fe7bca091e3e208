"""Without open3d, or a library that it needs, only what needs it fails, with the command that
installs it.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path

import pytest
from helpers.worlds import room

from dynaviz import api
from dynaviz.errors import MissingDependency
from dynaviz.sources.drive import Drive
from dynaviz.sources.odometry.refine import refine
from dynaviz.synthetic.simulate import simulate

LIBUSB = "libusb-1.0.so.0: cannot open shared object file: No such file or directory"


@pytest.fixture
def broken(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """An open3d that needs a shared library which is not installed."""
    (tmp_path / "packages/open3d").mkdir(parents=True)
    (tmp_path / "packages/open3d/__init__.py").write_text(f"raise ImportError({LIBUSB!r})")
    monkeypatch.syspath_prepend(tmp_path / "packages")
    monkeypatch.delitem(sys.modules, "open3d", raising=False)


@pytest.mark.usefixtures("broken")
@pytest.mark.parametrize(
    ("system", "command"), [("linux", "apt-get install .*libusb-1.0-0"), ("win32", "pip install")]
)
def test_a_library_is_missing(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, system: str, command: str
) -> None:
    monkeypatch.setattr(sys, "platform", system)
    message = (
        f" needs open3d, which cannot be loaded: {re.escape(LIBUSB)}. Install what it needs with: "
        f"{command}"
    )
    with pytest.raises(MissingDependency, match=f"^ray casting{message}"):
        simulate("square_mid360", tmp_path / "scene", frames=2)
    assert not (tmp_path / "scene").exists()
    with pytest.raises(MissingDependency, match=f"^refine_poses=True{message}"):
        refine(Drive.of(room(3, 300)))
    assert api.run("octomap", room(3, 300)).sequence.frames == 3


def test_open3d_is_not_installed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "open3d", None)
    with pytest.raises(
        MissingDependency, match=r"^refine_poses=True needs open3d\. Install it with: pip install"
    ):
        refine(Drive.of(room(3, 300)))
