"""Load open3d, which casts rays against meshes and registers scans."""

from __future__ import annotations

import sys
from typing import Any

from dynaviz.errors import MissingDependency

LINUX = "libegl1 libgl1 libgomp1 libidn2-0 libusb-1.0-0 libx11-6"
"""Debian's packages with the shared libraries that open3d's wheels need and do not contain."""


def load(purpose: str) -> Any:
    """The package open3d.

    Args:
        purpose: what needs it; the message starts with this.

    Raises:
        MissingDependency: if open3d is not installed, or a shared library that it needs.
    """
    try:
        import open3d
    except ModuleNotFoundError as error:
        raise MissingDependency(
            f"{purpose} needs {error.name}. Install it with: pip install open3d"
        ) from None
    except (ImportError, OSError) as error:
        install = (
            f"apt-get install {LINUX}"
            if sys.platform == "linux"
            else "pip install --force-reinstall open3d"
        )
        raise MissingDependency(
            f"{purpose} needs open3d, which cannot be loaded: {error}. Install what it needs with: "
            f"{install}"
        ) from None
    return open3d
