"""Sections of metrics as in a result file."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from dynaviz.scores.sections import Sections


def plain(found: Mapping[str, Any]) -> dict[str, Any]:
    """What a metric found, as JSON values that a file contains; NaN is an error."""
    values: dict[str, Any] = json.loads(json.dumps(Sections.of(found).plain(), allow_nan=False))
    return values
