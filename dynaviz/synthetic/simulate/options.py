"""A preset with options, as written on the command line.

``street_hdl64?frames=20&seed=3&jitter_m=0.03``.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from dynaviz.errors import UsageError
from dynaviz.synthetic.query import options_of, whole
from dynaviz.synthetic.simulate.effects import NAMES, parse_value
from dynaviz.synthetic.simulate.presets import PRESETS, Preset


@dataclass(frozen=True)
class Chosen:
    """A preset, number of frames and seed.

    Attributes:
        preset: the preset, with the effects of the options.
        frames: number of sweeps.
        seed: random seed.
        text: the preset with the options that change its effects, for names.
    """

    preset: Preset
    frames: int
    seed: int
    text: str

    @classmethod
    def parse(cls, text: str, frames: int | None = None, seed: int | None = None) -> Chosen:
        """Read a preset with its options; ``frames`` and ``seed`` replace those of the options.

        Raises:
            UsageError: for an unknown preset or option, a value that is not a number or out of
                range.
        """
        name, _, query = text.partition("?")
        if name not in PRESETS:
            raise UsageError(f"unknown scene '{name}'. Known: {', '.join(PRESETS)}")
        values = _values(text, query)
        preset = PRESETS[name]
        numbers = {
            "frames": preset.frames,
            "seed": 0,
            **{key: values.pop(key) for key in ("frames", "seed") if key in values},
        }
        frames = numbers["frames"] if frames is None else frames
        seed = numbers["seed"] if seed is None else seed
        if frames < 1 or seed < 0:
            raise UsageError(
                f"frames {frames}, seed {seed}: invalid. Give at least one frame and a seed of at "
                "least 0"
            )
        changed = "&".join(f"{key}={value}" for key, value in values.items())
        preset = replace(preset, effects=replace(preset.effects, **values))
        return cls(preset, frames, seed, f"{name}?{changed}" if changed else name)

    @property
    def effects(self) -> dict[str, Any]:
        """The table ``effects`` of ``sequence.toml``; empty if all are off."""
        active = self.preset.effects.active
        return {"effects": active} if active else {}


def _values(text: str, query: str) -> dict[str, Any]:
    """The options of a query."""
    place = f"simulate:{text}"
    return {
        key: whole(place, key, value)
        if key in ("frames", "seed")
        else parse_value(key, value, place)
        for key, value in options_of(place, query, ("frames", "seed", *NAMES)).items()
    }
