"""The labels of a run, frame by frame, packed with one bit per point."""

from __future__ import annotations

import os
import zipfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import overload

import numpy as np

from dynaviz.arrays import I64, U8, Bool
from dynaviz.errors import DataError
from dynaviz.io.npy import open_npy


class RunLabels(Sequence[Bool]):
    """Labels by position of the frame.

    ``labels[i]`` is (N,) bool, True for points that the method removed.

    Args:
        packed: (bytes,) uint8: one bit per point in the order of the sequence, as
            ``numpy.packbits`` packs them.
        points: (frames,) int64: number of points of each frame.
        frames: (frames,) int64: their numbers.
        reasons: (points,) uint8: code of the reason for each label; None if they are not at hand.
        legend: names of the reasons by code.
        sequence_digest: of the sequence that they are for; empty if unknown.

    Attributes:
        packed, frames, reasons, legend, sequence_digest: as given.
    """

    def __init__(
        self,
        packed: U8,
        points: I64,
        frames: I64 | None = None,
        reasons: U8 | None = None,
        legend: tuple[str, ...] = (),
        sequence_digest: str = "",
    ) -> None:
        self.packed = packed
        self._ends = np.concatenate([[0], np.cumsum(points)])
        self.frames = np.arange(len(points)) if frames is None else frames
        self.reasons = reasons
        self.legend = legend
        self.sequence_digest = sequence_digest

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> RunLabels:
        """Read the ``labels.npz`` of a run (``dynaviz.engine.outputs.LabelsFile``).

        Raises:
            DataError: if the file cannot be read or is damaged.
        """
        with open_npy(path, "labels.npz of a run", "Give that file, or a cleaned map") as z:
            for key, kinds in (
                ("points", "iu"),
                ("frames", "iu"),
                ("dynamic", "u"),
                ("reasons", "u"),
            ):
                if (
                    z[key].ndim != 1
                    or z[key].dtype.kind not in kinds
                    or (kinds == "u" and z[key].dtype != np.uint8)
                ):
                    raise ValueError(f"{key} is an array {z[key].shape} of {z[key].dtype}")
            points = z["points"].astype(np.int64)
            frames = z["frames"].astype(np.int64)
            legend = tuple(str(reason) for reason in z["reason_names"])
            found = cls(
                z["dynamic"], points, frames, z["reasons"], legend, str(z["sequence_digest"])
            )
            reasons = len(z["reasons"])
        total = int(points.sum())
        unique = len(set(frames.tolist()))
        lengths = (
            reasons == total,
            len(found.packed) == -(-total // 8),
            unique == len(points) == len(frames),
        )
        if (points < 0).any() or not all(lengths):
            raise DataError(
                path,
                "is inconsistent: its arrays have different lengths",
                hint="Write or copy it again",
            )
        return found

    def reasons_of(self, position: int) -> U8:
        """(N,) uint8: codes of the reasons of a frame."""
        assert self.reasons is not None
        codes: U8 = self.reasons[self._ends[position] : self._ends[position + 1]]
        return codes

    def __len__(self) -> int:
        return len(self._ends) - 1

    @overload
    def __getitem__(self, position: int) -> Bool: ...

    @overload
    def __getitem__(self, position: slice) -> list[Bool]: ...

    def __getitem__(self, position: int | slice) -> Bool | list[Bool]:
        if isinstance(position, slice):
            return [self[k] for k in range(*position.indices(len(self)))]
        first, end = (
            int(self._ends[k]) for k in (range(len(self))[position], range(len(self))[position] + 1)
        )
        bits = np.unpackbits(self.packed[first // 8 : -(-end // 8)])
        return bits[first % 8 : first % 8 + end - first].astype(np.bool_)

    def __iter__(self) -> Iterator[Bool]:
        return (self[k] for k in range(len(self)))

    def __repr__(self) -> str:
        return f"<RunLabels of {len(self):,} frames, {int(self._ends[-1]):,} points>"


def reasons_by_frame(path: Path, labels: RunLabels) -> Iterator[U8]:
    """(N,) uint8 for each frame.

    The codes in the ``labels.npz`` of a run with these labels, read piece by piece.
    """
    with zipfile.ZipFile(path) as archive, archive.open("reasons.npy") as file:
        np.lib.format.read_magic(file)
        np.lib.format.read_array_header_1_0(file)
        for frame in labels:
            yield np.frombuffer(file.read(len(frame)), np.uint8)
