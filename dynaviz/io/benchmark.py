"""Write the layout of the public benchmark (Zhang et al. 2023).

Scans in the world frame, and one labelled cloud.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from dynaviz.arrays import F32, I32, U8, U16
from dynaviz.io.atomic import atomic_folder
from dynaviz.io.pcd import PcdWriter, write_pcd

_LAYOUT = dict.fromkeys(("x", "y", "z", "intensity"), np.float32)


class BenchmarkWriter:
    """Writes a sequence scan by scan; the folder appears only when the ``with`` block succeeds.

    ``pcd/NNNNNN.pcd`` contain x y z intensity as float32 and the sensor pose as VIEWPOINT.
    ``gt_cloud.pcd`` is created with the first labels; it contains all points in scan order with the
    label as intensity, followed by the fields ``class`` and ``instance``. ``sequence.toml``
    contains the metadata. All PCD files are binary.

    Args:
        out: the folder to create; it must not exist yet.

    Raises:
        DataError: if the folder exists or cannot be written.
    """

    def __init__(self, out: str | os.PathLike[str]) -> None:
        self._out = Path(out)
        self._cloud: PcdWriter | None = None
        self._stack = contextlib.ExitStack()

    def __enter__(self) -> BenchmarkWriter:
        self._folder = self._stack.enter_context(atomic_folder(self._out))
        return self

    def __exit__(self, *error: Any) -> None:
        self._stack.__exit__(*error)

    def append(
        self,
        index: int,
        points: F32,
        T_world_sensor: ArrayLike,
        intensity: F32 | None = None,
        lidar: U8 | None = None,
    ) -> None:
        """Add a scan.

        Args:
            index: frame number.
            points: (N, 3) float32, metres, world frame.
            T_world_sensor: (4, 4) float64, metres, the sensor pose.
            intensity: (N,) float32; 0 by default.
            lidar: (N,) uint8, the lidar that measured each point, if several were merged.
        """
        fields: dict[str, Any] = dict(zip("xyz", points.T, strict=True))
        fields["intensity"] = np.zeros(len(points), np.float32) if intensity is None else intensity
        if lidar is not None:
            fields["lidar"] = lidar
        write_pcd(self._folder / "pcd" / f"{index:06d}.pcd", fields, T_world_sensor)

    def append_truth(
        self,
        points: F32,
        labels: U8,
        classes: U16 | None = None,
        instances: I32 | None = None,
    ) -> None:
        """Add the ground truth of a scan. Call it for every scan, in order, or for none.

        Args:
            points: (N, 3) float32, the points of the scan.
            labels: (N,) uint8, a ``Label`` per point.
            classes: (N,) uint16, the data set's class per point; 0 by default.
            instances: (N,) int32, object number per point, 0 (the default) for no object.
        """
        if self._cloud is None:
            fields = {**_LAYOUT, "class": np.uint16, "instance": np.int32}
            self._cloud = self._stack.enter_context(
                PcdWriter(self._folder / "gt_cloud.pcd", fields)
            )
        truth: dict[str, Any] = {
            "intensity": labels.astype(np.float32),
            "class": np.zeros(len(points), np.uint16) if classes is None else classes,
            "instance": np.zeros(len(points), np.int32) if instances is None else instances,
        }
        self._cloud.append(**dict(zip("xyz", points.T, strict=True)), **truth)

    def describe(self, facts: Mapping[str, Any], class_names: Mapping[int, str]) -> None:
        """Write ``sequence.toml``: facts that are not None, and the table of class names."""
        import tomli_w

        table = {key: value for key, value in facts.items() if value is not None}
        if class_names:
            table["classes"] = {str(number): name for number, name in class_names.items()}
        (self._folder / "sequence.toml").write_bytes(tomli_w.dumps(table).encode())
