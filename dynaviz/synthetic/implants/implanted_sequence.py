"""A sequence with implanted movers; ``implant:SEQUENCE?cars=6&seed=3`` opens one."""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import ClassVar, Self

from dynaviz.arrays import Bool
from dynaviz.contracts.attributes import Attributes
from dynaviz.contracts.scan import Scan, Sequence
from dynaviz.errors import UsageError
from dynaviz.io.atomic import write_atomic
from dynaviz.progress import Progress, silent
from dynaviz.sources.carrier import with_carrier
from dynaviz.sources.datasets import open_sequence
from dynaviz.sources.datasets.convert import Conversion, convert
from dynaviz.sources.derived import Derived
from dynaviz.sources.drive import Drive
from dynaviz.synthetic.implants.cast import implant
from dynaviz.synthetic.implants.implant_options import COUNTS, ImplantOptions, parse
from dynaviz.synthetic.implants.implant_scene import ImplantScene
from dynaviz.synthetic.implants.lidar_model import LidarModel
from dynaviz.synthetic.implants.plan import plan
from dynaviz.synthetic.implants.space import SpaceAboveGround
from dynaviz.synthetic.implants.survey import Survey


class ImplantedSequence(Derived):
    """A sequence whose scans show movers that were not there.

    The static world, the noise, the poses and their errors stay those of the sequence. Scans are
    made when they are read; reading a frame twice gives the same arrays. Points of the sequence
    keep their labels; points without a label are unlabelled.

    Args:
        base: the sequence.
        scene: the movers.
        lidar: as measured on the sequence.
        name: name of the result.
        panel: names of the methods behind ``static``.
        static: gives for a position the points that count as static if they have no label of their
            own.
    """

    layout: ClassVar[str] = "another sequence with implanted movers: implant:SEQUENCE?cars=6&seed=3"
    nested: ClassVar[bool] = True

    def __init__(
        self,
        base: Sequence,
        scene: ImplantScene,
        lidar: LidarModel,
        name: str,
        panel: tuple[str, ...] = (),
        static: Callable[[int], Bool] | None = None,
    ) -> None:
        self.whole = Drive.of(base)
        self.scene = scene
        self.lidar = lidar
        self._name = name
        self.panel = panel
        self._static = static

    @classmethod
    def matches(cls, path: Path) -> bool:
        """Never: only the prefix opens a sequence with implants."""
        return False

    @classmethod
    def open(
        cls,
        path: Path,
        poses: str | None = None,
        points_in: str | None = None,
        deskew: bool | None = None,
    ) -> Self:
        """Open ``SEQUENCE?cars=6&seed=3``; the other arguments are passed on to the sequence.

        Raises:
            UsageError: for invalid options, or a sequence without free space for movers.
            DataError: for a sequence or a scene file that cannot be read.
        """
        text, options = parse(str(path))
        return cls.of(open_sequence(text, poses=poses, points_in=points_in, deskew=deskew), options)

    @classmethod
    def of(cls, base: Sequence, options: ImplantOptions, progress: Progress = silent) -> Self:
        """Plan movers for a sequence, or take them from the scene file.

        Raises:
            UsageError, DataError: as ``open``.
        """
        base = Drive.of(base).select(options.frames, options.stride)
        lidar = LidarModel.measure(base)
        agreed = None
        if options.panel:
            from dynaviz.synthetic.implants.panel import votes

            agreed = votes(base, options.panel, progress)
        if options.scene is not None:
            scene = ImplantScene.load(Path(options.scene))
            name = f"{base.name}-{Path(options.scene).stem}"
        else:
            known = agreed.dynamic if agreed else None
            survey = Survey.of(
                with_carrier(base), lambda done, total: progress("survey", done, total), known
            )
            scene = planned(base.name, options, lidar, survey)
            name = f"{base.name}-implants" + (f"-seed{options.seed}" if options.seed else "")
        return cls(base, scene, lidar, name, options.panel, agreed.static if agreed else None)

    @property
    def name(self) -> str:
        """The name of the result."""
        return self._name

    @property
    def exact(self) -> bool:
        """Always: poses and sensor are those of the sequence, which is checked itself."""
        return True

    @property
    def has_labels(self) -> bool:
        """Always: implanted points are dynamic."""
        return True

    @property
    def facts(self) -> Mapping[str, str]:
        """Those of the sequence, and what was implanted and measured."""
        kinds = [mover.kind for mover in self.scene.movers]
        counts = ", ".join(f"{kinds.count(kind)} {kind}" for kind in dict.fromkeys(kinds))
        return {
            **self.whole.facts,
            "implants": counts or "none",
            "range noise": f"{1000 * self.scene.range_noise:.0f} mm",
            "drop-outs": f"{100 * self.scene.drop_out:.1f} %",
            "rays without a return": self.sky,
            "scores": f"DA over the implants{self._da}, SA over {self._sa}",
        }

    @property
    def _da(self) -> str:
        return " and the points labelled dynamic" if self.whole.has_labels else ""

    @property
    def _sa(self) -> str:
        own = "the points labelled static"
        agreed = f"the points that most of {', '.join(self.panel)} keep"
        if self.whole.has_labels:
            return f"{own}, and {agreed} among those without a label" if self.panel else own
        return agreed if self.panel else "no points; give a panel of methods"

    @property
    def sky(self) -> str:
        """Whether movers are seen in front of the sky, in one line."""
        if self.scene.sky_rays and self.lidar.sky_rays:
            return "known from the regular scan pattern, so movers in front of the sky are seen"
        reason = (
            "switched off in the scene file"
            if self.lidar.sky_rays
            else "unknown, the scan pattern is not regular"
        )
        return f"{reason}; movers return only rays that also returned without them"

    def attributes(self, position: int) -> Attributes:
        """None: no lidar measured those of implanted points."""
        return {}

    def coordinates(self, position: int) -> None:
        """None: the points of the scan tell as much."""

    def __getitem__(self, position: int) -> Scan:
        scan = self.whole[position]
        static = self._static(position % len(self)) if self._static else None
        return implant(scan, self.scene, self.lidar, static)


def planned(name: str, options: ImplantOptions, lidar: LidarModel, survey: Survey) -> ImplantScene:
    """Plan movers for a surveyed sequence.

    Raises:
        UsageError: if no mover finds a free path; if only some do, a warning counts the others.
    """
    found = plan(options, survey, SpaceAboveGround.of(survey))
    wanted = sum(getattr(options, name) for name in COUNTS)
    if not found.implants:
        raise UsageError(
            f"{name}: no free path for any of {wanted} movers. Give smaller movers, another seed "
            "or more frames"
        )
    if found.missing:
        left = ", ".join(f"{name} ({count})" for name, count in found.missing.items())
        warnings.warn(
            f"{name}: no free path for {left}; {len(found.implants)} movers placed", stacklevel=2
        )
    return ImplantScene(
        seed=options.seed,
        range_noise=lidar.range_noise,
        drop_out=lidar.drop_out,
        sky_rays=lidar.sky_rays,
        movers=found.implants,
        rate=survey.rate,
        start_ns=survey.start_ns,
        sequence=name,
    )


SCENE_FILE = "implants.toml"


def write(
    sequence: ImplantedSequence,
    out: str | os.PathLike[str],
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> Conversion:
    """Write ``out`` as ``dynaviz.sources.datasets.convert`` does, with the scene as
    ``out/implants.toml``.

    Raises:
        DataError: if ``out`` exists or cannot be written, or the sequence cannot be read.
    """
    done = convert(sequence, out, progress)
    write_atomic(Path(out) / SCENE_FILE, sequence.scene.to_toml())
    return done
