"""What to implant: numbers of movers, a seed, a scene file.

As options or as the query of a path.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

from dynaviz.errors import UsageError
from dynaviz.synthetic.query import options_of, whole

MOST = 1000  # movers of a kind


@dataclass(frozen=True)
class ImplantOptions:
    """Movers to place into a sequence.

    Attributes:
        cars, trucks, cyclists, persons: number of movers; some of them wait on their way.
        parks: number of cars that arrive and park, in addition to ``cars``.
        seed: random seed of paths, shapes and noise.
        frames, stride: frames of the sequence to use, as in ``dynaviz.open``.
        scene: a scene file; it replaces the numbers of movers and the seed.
        panel: methods that vote on which unlabelled points are static
            (``dynaviz.synthetic.implants.panel``).
    """

    cars: int = 4
    trucks: int = 1
    cyclists: int = 2
    persons: int = 6
    parks: int = 1
    seed: int = 0
    frames: str | None = None
    stride: int = 1
    scene: str | None = None
    panel: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Raise UsageError for numbers out of range."""
        for name in COUNTS:
            if not 0 <= getattr(self, name) <= MOST:
                raise UsageError(f"implants: {name} = {getattr(self, name)}: give 0 to {MOST}")
        if not 0 <= self.seed < 2**32:
            raise UsageError(f"implants: seed = {self.seed}: give a seed from 0 to 2^32 - 1")
        if self.scene is None and not any(getattr(self, name) for name in COUNTS):
            raise UsageError("implants: no movers. Give cars, trucks, cyclists, persons or parks")


COUNTS = ("cars", "trucks", "cyclists", "persons", "parks")
_NUMBERS = (*COUNTS, "seed", "stride")


def parse(text: str) -> tuple[str, ImplantOptions]:
    """Split ``SEQUENCE?cars=6&seed=3`` into the sequence and the options.

    Raises:
        UsageError: for an unknown key, a value that is not a number, or a missing sequence.
    """
    path, _, query = text.partition("?")
    if not path or path == ".":
        raise UsageError("implant: gives no sequence. Write implant:SEQUENCE?cars=6&seed=3")
    place = f"implant:{text}"
    given = options_of(place, query, [option.name for option in fields(ImplantOptions)])
    return path, ImplantOptions(**{key: _value(place, key, value) for key, value in given.items()})


def _value(place: str, key: str, value: str) -> Any:
    if key in _NUMBERS:
        return whole(place, key, value)
    if key == "panel":
        return () if value == "none" else tuple(filter(None, value.split(",")))
    return value
