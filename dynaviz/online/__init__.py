"""Live use: label scans as they come, in bounded memory.

Private: other packages do not import it.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from typing import Any

from dynaviz import kernels
from dynaviz.contracts import params, registry
from dynaviz.contracts.method import Live, Method
from dynaviz.contracts.registry import BEST
from dynaviz.contracts.sensors import Sensor, load_sensor
from dynaviz.errors import UsageError
from dynaviz.online.session import LiveSession, Settings, warm_up

__all__ = ["LiveSession", "live", "why_not_live"]


def live(
    method: str = BEST,
    *,
    sensor: str | Sensor | None = None,
    reach: float = 60.0,
    keep: int = 20,
    map_voxel: float = 0.2,
    preset: str | None = None,
    config: str | os.PathLike[str] | None = None,
    settings: Iterable[str] | Mapping[str, Any] = (),
    seed: int = 0,
    threads: int | None = None,
) -> LiveSession:
    """Start a method that labels scans as they come.

    Kernels are compiled here, so that the first scan takes no longer than others.

    Args:
        method: its name (``dynaviz list methods``).
        sensor: name of the sensor (``dynaviz list sensors``), a TOML file, or a ``Sensor``; some
            methods need none.
        reach: metres around the sensor within which points are judged. What lies a tenth farther is
            forgotten.
        keep: number of last scans that ``LiveSession.revise`` labels again, and with which
            some methods compare a scan.
        map_voxel: edge of the voxels of the static map, metres; one point each.
        preset, config, settings: layers of parameters, as for ``dynaviz.run``.
        seed: for all randomness in the method.
        threads: for kernels; None for all cores.

    Raises:
        UsageError: for an unknown method or sensor, an invalid number, or a method that cannot run
            live; says why.
    """
    check_numbers(reach, keep, map_voxel)
    kind = registry.load("methods", method)
    reason = why_not_live(kind)
    if reason:
        raise UsageError(f"{method} cannot run live: {reason}. Use one of {', '.join(_able())}")
    if kind.info.needs_map and keep == 0:
        raise UsageError(
            f"keep = 0: {method} compares each scan with the last ones. Give at least 1"
        )
    resolved = params.resolve(kind, preset, config, settings)
    chosen = load_sensor(sensor) if isinstance(sensor, str) else sensor or Sensor()
    kernels.set_threads(threads)
    options = Settings(reach, keep, map_voxel, seed)
    warm_up(kind, resolved.params, chosen, options)
    return LiveSession(kind(resolved.params), chosen, options)


def check_numbers(reach: float, keep: int, map_voxel: float) -> None:
    """Check numbers that a user gave.

    Raises:
        UsageError: for one that is out of range.
    """
    if not 1.0 <= reach <= 500.0:
        raise UsageError(f"reach = {reach}: give 1 to 500 metres")
    if keep < 0:
        raise UsageError(f"keep = {keep}: give a number of scans of at least 0")
    if not 0.01 <= map_voxel <= 10:
        raise UsageError(f"map_voxel = {map_voxel}: give 0.01 to 10 metres")


def why_not_live(kind: type[Method]) -> str | None:
    """Why a method cannot run live; None if it can."""
    if issubclass(kind, Live):
        return None
    if kind.info.needs_map:
        return (
            "it compares each scan with the map of all scans, which exists only after the last one"
        )
    return "it has no forget(index), so its memory would grow with every scan"


def _able() -> list[str]:
    return [
        name for name, kind in registry.loadable("methods").items() if why_not_live(kind) is None
    ]
