"""Give a method all facts of the sensor that it needs or uses, before a sequence is read."""

from __future__ import annotations

from typing import Any

from dynaviz.contracts.extent import Extent
from dynaviz.contracts.method import Context, Method
from dynaviz.contracts.scan import Scan
from dynaviz.contracts.sensors import Sensor
from dynaviz.sources.carrier import with_carrier
from dynaviz.sources.drive import Drive
from dynaviz.sources.sensing import with_needed_facts


def suited(method: type[Method], params: Any, sequence: Drive) -> Drive:
    """The sequence, with estimates in place of facts of the sensor that the method needs or uses
    and that are unknown.

    What carries the sensor is estimated, too, so that no method sees it.

    Args:
        method, params: what will run.
        sequence: what it will run on; some of its scans are read.

    Raises:
        UsageError: if the method needs a fact that cannot be estimated.
    """

    def begin(scan: Scan, sensor: Sensor) -> None:
        raw_map = scan.points if method.info.needs_map else None
        method(params).begin(Context(Extent.of(scan), sensor, raw_map=raw_map))

    return with_carrier(with_needed_facts(begin, sequence, method.info.uses))
