"""What the pictures of the demo are drawn from.

Colours, layouts and the files of the explorer, as digests.

``docs/draw.py demo`` keeps the digests next to the pictures, and a test compares them with those of
the present code.
"""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

import numpy as np

from dynaviz import colours, explorer
from dynaviz.contracts import registry
from dynaviz.contracts.extent import Extent
from dynaviz.views import paths
from dynaviz.views.compare import compare_layout
from dynaviz.views.layout import CIRCLES, Findings, layout

KEPT = Path(__file__).resolve().parent / "pictures/drawn.json"


def digests() -> dict[str, str]:
    """A digest for each source."""
    page = Path(explorer.__file__).with_name("page")
    tracked = dict.fromkeys((paths.CASE_AROUND, paths.CASE_AIM), CIRCLES)
    run = layout(
        registry.load("methods", "octomap").info,
        Extent.of(),
        True,
        Findings(cases=True, tracked=tracked),
    )
    two = compare_layout.two(("A", "B"), np.zeros((1, 3)), CIRCLES[:1])
    values = {name: value for name, value in vars(colours).items() if name.isupper()}
    methods = registry.loadable("methods")
    values["METHODS"] = {name: colours.method_colour(name) for name in sorted(methods)}
    sources = {
        "colours": repr(sorted(values.items())),
        "layout": repr([described(each.root_container) for each in (run, two)]),
        "explorer": repr([(file.name, file.read_text()) for file in sorted(page.iterdir())]),
    }
    return {name: hashlib.sha256(source.encode()).hexdigest() for name, source in sources.items()}


def described(part: Any) -> tuple[Any, ...]:
    """A container with all that it contains, or a view: what is shown, and under which names."""
    if hasattr(part, "class_identifier"):
        return part.class_identifier, str(part.name), str(part.origin), str(part.contents)
    shares = [getattr(part, name, None) for name in ("column_shares", "row_shares")]
    return (
        type(part).__name__,
        str(part.name),
        repr(shares),
        [described(inner) for inner in part.contents],
    )


def keep() -> None:
    """Write the digests."""
    KEPT.write_text(json.dumps(digests(), indent=1) + "\n")
