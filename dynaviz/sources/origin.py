"""Where a sequence came from and how good its poses are, as ``result.json`` states it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from msgspec import Struct

from dynaviz.contracts.sensors import Sensor
from dynaviz.errors import addressed
from dynaviz.sources.options import SequenceOptions


@dataclass(frozen=True)
class EstimatedPoses:
    """Poses that an odometry estimated, and how.

    Attributes:
        file: CSV file with a pose per line: number or stamp in nanoseconds, and the 3x4 matrix.
        odometry: its name.
        version: of its package.
        frames: number of sweeps.
        distance: metres travelled.
        seconds: it took to estimate them.
        deskewed: whether the times of points were used to compensate motion.
        key: digest of the sequence and the odometry.
        reused: whether they were estimated by an earlier run.
    """

    file: Path
    odometry: str
    version: str
    frames: int
    distance: float
    seconds: float
    deskewed: bool
    key: str
    reused: bool = False

    def __str__(self) -> str:
        times = f"{self.seconds:.0f} s" + (", estimated by an earlier run" if self.reused else "")
        return (
            f"{self.odometry} {self.version}: {self.distance:.1f} m in {self.frames:,} sweeps "
            f"({times})"
        )


class PoseNoise(Struct, frozen=True):
    """Noise of poses between neighbouring frames, measured on planes
    (``dynaviz.sources.pose_noise``).

    Attributes:
        translation_m: standard deviation of a frame's position along each axis, metres.
        rotation_deg: standard deviation of a frame's rotation about each axis, degrees.
        patches: median number of planar patches per frame; frames: number of frames compared.
    """

    translation_m: float
    rotation_deg: float
    patches: int = 0
    frames: int = 0

    def __str__(self) -> str:
        return f"{100 * self.translation_m:.1f} cm and {self.rotation_deg:.2f} degrees"


class PoseRefinement(Struct, frozen=True):
    """How far ``--refine-poses`` moved the poses of a run, and their noise before and after.

    Attributes:
        median_m, max_m: distance between the given and the refined position of a frame, metres.
        median_deg, max_deg: angle between the given and the refined rotation of a frame, degrees.
        frames: frames that were registered; all others keep their pose.
        before, after: noise of the poses; None if too few planes are seen.
        seconds: processor time of the refinement; reused: whether an earlier run refined the poses.
    """

    median_m: float
    max_m: float
    median_deg: float
    max_deg: float
    frames: int = 0
    before: PoseNoise | None = None
    after: PoseNoise | None = None
    seconds: float = 0.0
    reused: bool = False

    def __str__(self) -> str:
        shift = f"{100 * self.median_m:.1f} cm (at most {100 * self.max_m:.1f} cm)"
        moved = f"moved by {shift} and {self.median_deg:.2f} degrees (at most {self.max_deg:.2f})"
        return (
            f"{moved}; noise {self.before} before, {self.after} after"
            if self.before and self.after
            else moved
        )


class PoseFinding(Struct, frozen=True):
    """A finding of the doctor on poses, frames or units that is likely, from a few scans
    (``diagnosis.quick_check``).

    Attributes:
        name, problem, fix: as in ``dynaviz.diagnosis.Finding``.
        option: the option that fixes it, such as ``--points-in world``; empty if the data must be
            written again.
    """

    name: str
    problem: str
    fix: str
    option: str = ""

    def __str__(self) -> str:
        return addressed(f"{self.name}: {self.problem}. {self.fix}")


class SourceReading(Struct, frozen=True, omit_defaults=True):
    """How the numbers of a source were read: what was found in it, stated, or assumed.

    Attributes:
        poses: where they are from, and how they were matched with the scans.
        times: where the times of the scans are from.
        points_in: frame of the points in the source.
        deskewed: whether motion during the sweep was compensated here, and why.
        columns: what the columns of files without titles hold; empty if the files name them.
        units: of lengths.
        mount: pose of the lidar on the vehicle.
        coordinates: their type in the source, and its steps there if they are coarse.
    """

    poses: str = ""
    times: str = ""
    points_in: str = ""
    deskewed: str = ""
    columns: str = ""
    units: str = "metres"
    mount: str = ""
    coordinates: str = ""

    def rows(self) -> list[tuple[str, str]]:
        """What and how, in words; only what is known."""
        named = (
            ("poses", self.poses),
            ("times", self.times),
            ("points in", self.points_in),
            ("deskewed", self.deskewed),
            ("columns", self.columns),
            ("units", self.units),
            ("mount", self.mount),
            ("coordinates", self.coordinates),
        )
        return [(name, value) for name, value in named if value]


class Origin(Struct, frozen=True, omit_defaults=True):
    """Where the sequence of a run came from.

    Enough to open the same frames with the same poses again.

    Attributes:
        sources: paths or URIs as they were given, such as ``drive.bag#/front`` or
            ``simulate:demo?seed=3``; several for drives in one world frame; none for arrays in
            memory.
        absolute: the same with absolute paths.
        format: the class that read it.
        options: how it was opened.
        odometry: name and version of the odometry that estimated the poses; empty for given poses.
        poses_file: file with these poses, relative to the folder of the run if it is in there.
        refined: whether poses were refined; they are in ``poses_refined.csv`` in the folder of the
            run.
        positions: start, stop and step of the frames that were selected after opening; None for
            all.
        name: of the sequence in tables.
        sensor: the facts of the sensor that the run used.
        estimated: names of those that were estimated from the scans.
    """

    sources: tuple[str, ...] = ()
    absolute: tuple[str, ...] = ()
    format: str = ""
    options: SequenceOptions = SequenceOptions()
    odometry: str = ""
    poses_file: str = ""
    refined: bool = False
    positions: tuple[int, int, int] | None = None
    name: str = ""
    sensor: Sensor | None = None
    estimated: tuple[str, ...] = ()
