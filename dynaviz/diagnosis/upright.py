"""Check which way is up.

The ground below the sensor, and sensors or worlds that lie on their side.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from dynaviz.arrays import F32, F64
from dynaviz.contracts.scan import Scan
from dynaviz.diagnosis.alignment import Pairs
from dynaviz.diagnosis.finding import Confidence, Finding, settable
from dynaviz.diagnosis.trajectory import (
    CAMERA,
    FAULTS,
    MAX_TILT,
    W_FIRST,
    W_LAST,
    PoseFault,
    backwards,
    tilt_of,
)
from dynaviz.sources.hypotheses.views import ScanView, ground_below, to_z
from dynaviz.spatial import geometry
from dynaviz.spatial.sensor_height import FLAT

UPRIGHT = 20.0  # degrees of tilt that are left after a correction, at most
NARROWER = 0.7  # factor by which the right axis makes the vertical field of view narrower
AXES = {"y": (0, 1, 0), "-y": (0, -1, 0), "x": (1, 0, 0), "-x": (-1, 0, 0), "-z": (0, 0, -1)}


def check_up(views: Pairs, poses: Sequence[F64]) -> Iterator[Finding]:
    """Find worlds whose up is not z, and sensors that lie on their side, drive straight up or face
    backwards.
    """
    T = np.array(poses)
    tilt = tilt_of(T)
    scans = [b for _, b in views]
    if fault := _turned_over(views, T, tilt):
        yield fault
        return
    if found := _other_up(scans, tilt):
        yield found
        return
    if tilt > MAX_TILT:
        yield _tilted(T, tilt, scans)
        return
    extent = np.ptp(T[:, :3, 3], axis=0)
    if extent[2] > 2.0 and extent[2] > 2 * np.hypot(*extent[:2]):
        evidence = (
            f"the sensor climbs {extent[2]:.1f} m while it moves {np.hypot(*extent[:2]):.1f} m "
            "horizontally"
        )
        yield Finding(CAMERA.name, Confidence.PERHAPS, f"{CAMERA.problem}: {evidence}", CAMERA.fix)
        return
    if turned := backwards(T):
        yield Finding(W_LAST.name, Confidence.LIKELY, f"{W_LAST.problem}: {turned}", W_LAST.fix)


def _turned_over(views: Pairs, T: F64, tilt: float) -> Finding | None:
    """A finding on quaternions whose order turns a world upside down.

    The sensor lies on its back and rolls as it turns. In the other order it stands upright in all
    poses, with the ground below.
    """
    if tilt < 90 + MAX_TILT or not views:
        return None
    rest = 180 - tilt_of(T, 10)
    for fault in (W_FIRST, W_LAST):
        corrected = np.array([fault.correct(pose) for pose in T])
        left = tilt_of(corrected, 90)
        if left > UPRIGHT or left > rest - 1.0:
            continue
        scans = [
            ScanView(Scan(b.index, _moved(b, fault), fault.correct(b.T), b.stamp)) for _, b in views
        ]
        below = np.mean([ground_below(s, np.array([0.0, 0.0, 1.0]))[1] >= FLAT for s in scans])
        if below >= 0.5:
            evidence = (
                f"the sensor is upside down, tilted by {tilt:.0f} degrees, after correction by "
                f"{left:.0f}, with the ground below"
            )
            return Finding(fault.name, Confidence.LIKELY, f"{fault.problem}: {evidence}", fault.fix)
    return None


def _moved(view: ScanView, fault: PoseFault) -> F32:
    """(N, 3) metres: points that the wrong pose placed, placed by the right one."""
    move = geometry.compose(fault.correct(view.T), geometry.inverse(view.T))
    return geometry.apply(move, view.sample).astype(np.float32)


def _other_up(scans: Sequence[ScanView], tilt: float) -> Finding | None:
    """A finding if the ground is flat along another axis of the world than z, and the vertical
    field of view narrower.

    The sensor's z axis points along that axis, or along the world's z if both have other axes, as
    in a camera's frame.
    """
    if not scans:
        return None
    z = np.array([0.0, 0.0, 1.0])
    axes = {name: np.array(up, np.float64) for name, up in AXES.items()}
    flat = {
        name: float(np.mean([ground_below(s, up)[1] for s in scans])) for name, up in axes.items()
    }
    given = float(np.mean([ground_below(s, z)[1] for s in scans]))
    along = {name: float(np.median([s.T[:3, 2] @ up for s in scans])) for name, up in axes.items()}
    name = (
        max(along, key=lambda name: along[name])
        if tilt > MAX_TILT
        else max(flat, key=lambda name: flat[name])
    )
    up = axes[name]
    if tilt > MAX_TILT:
        turned = along[name] < np.cos(np.radians(UPRIGHT)) or not (
            name == "-z" or _narrow(scans, up, z)
        )
        if turned or given >= FLAT or flat[name] < max(given, FLAT):
            return None
    elif flat[name] < FLAT + given or not _narrow(scans, up, z):
        return None
    rotation = ", ".join(str([round(float(x)) for x in row]) for row in to_z(up))
    return Finding(
        "world not z-up",
        Confidence.LIKELY,
        f"the ground is flat along the world's {name} axis: {flat[name]:.0%} of the cells around "
        "the sensor "
        f"show ground, along z only {given:.0%}, so {name} points up",
        f"Rotate the world: with R = [{rotation}], write R @ T[:3] for each pose, and R @ points "
        "if points are in the "
        "world frame",
    )


def _tilted(T: F64, tilt: float, scans: Sequence[ScanView]) -> Finding:
    """A finding on a sensor that lies on its side.

    A fault of poses if that also narrows the vertical field of view.
    """
    for fault in FAULTS[1:]:
        corrected = tilt_of(np.array([fault.correct(pose) for pose in T]))
        if corrected < UPRIGHT and _narrower(scans, [fault.correct(s.T)[:3, 2] for s in scans]):
            evidence = (
                f"the sensor is tilted by {tilt:.0f} degrees, after correction by {corrected:.0f}"
            )
            return Finding(fault.name, Confidence.LIKELY, f"{fault.problem}: {evidence}", fault.fix)
    problem = f"the sensor's z axis is tilted by {tilt:.0f} degrees from the world's"
    fix = (
        "Rotate the world so that z points up. A tilted mount is fine in itself, but methods then "
        "find no ground"
    )
    return Finding("tilted", Confidence.PERHAPS, problem, fix)


def _narrow(scans: Sequence[ScanView], axis: F64, other: F64) -> bool:
    """Whether the fields of view are clearly narrower about an axis of the world than about
    another.
    """
    return (
        float(np.median([_spread(s, axis) / max(_spread(s, other), 1e-6) for s in scans]))
        < NARROWER
    )


def _narrower(scans: Sequence[ScanView], axes: Sequence[F64]) -> bool:
    """Whether the fields of view are clearly narrower about other axes than about the sensor's z
    axis.
    """
    spreads = [
        (_spread(s, axis), _spread(s, s.T[:3, 2])) for s, axis in zip(scans, axes, strict=True)
    ]
    return bool(spreads) and float(np.median([a / max(b, 1e-6) for a, b in spreads])) < NARROWER


def _spread(view: ScanView, axis: F64) -> float:
    """Vertical field of view about an axis of the world, degrees, that contains 96 %
    of the points.
    """
    rays = view.sample - view.T[:3, 3]
    ranges = np.maximum(np.sqrt((rays * rays).sum(1)), 1e-6)
    elevation = np.degrees(np.arcsin(np.clip((rays * axis).sum(1) / ranges, -1, 1)))
    low, high = np.percentile(elevation, [2, 98])
    return float(high - low)


def ground(views: Pairs, height: float | None, sensor: str) -> Iterator[Finding]:
    """Compare the sensor's height above the ground with the height in its file."""
    found = [h for _, b in views if (h := ground_height(b)) is not None]
    if height is None or len(found) < max(1, len(views) // 2):
        return
    measured = float(np.median(found))
    if abs(measured - height) > max(0.5, 0.35 * height):
        problem = (
            f"the ground is {measured:.1f} m below the sensor, but the mounting height of {sensor} "
            f"is {height:.1f} m"
        )
        option = settable("sensor_height", f"{measured:.2f}")
        fix = (
            "Give the sensor with --sensor NAME (see 'dynaviz list sensors'), or its height: "
            f"{option}"
        )
        yield Finding("ground height", Confidence.LIKELY, problem, fix)


def ground_height(view: ScanView) -> float | None:
    """Height of the sensor above the ground, metres; None if the ground is not seen well enough."""
    height, share = ground_below(view, np.array([0.0, 0.0, 1.0]))
    return height if share >= FLAT else None
