"""Which code a plug-in runs: its package and version, and a digest of its source files."""

from __future__ import annotations

from functools import cache

from msgspec import Struct

from dynaviz import source_files
from dynaviz.contracts import registry

SHARED = ("dynaviz.kernels", "dynaviz.blocks", "dynaviz.spatial")
"""Packages of dynaviz whose code may decide labels."""


class Plugin(Struct, frozen=True):
    """The code of a plug-in.

    Attributes:
        target: ``module:Class``.
        package, version: the distribution that provides it.
        sha256: digest of its module and of the modules that this imports from its own package, from
            ``kernels``, ``blocks`` and ``spatial``, with the packages that it gives to
            ``kernels.load``; empty if they have no source files.
    """

    target: str = ""
    package: str = ""
    version: str = ""
    sha256: str = ""


@cache
def plugin(kind: str, name: str) -> Plugin | None:
    """The code of a plug-in; None if none of this kind has the name."""
    handle = next((handle for handle in registry.handles(kind) if handle.name == name), None)
    if handle is None:
        return None
    files = source_files.closure(
        handle.target.partition(":")[0],
        lambda module: source_files.is_within(module, handle.package, *SHARED),
    )
    digest = source_files.digest(files) if files else ""
    return Plugin(handle.target, handle.distribution, handle.version, digest)
