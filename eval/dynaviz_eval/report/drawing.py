"""Style of figures: a colour and a marker for each method, and SVG for light and dark pages."""

from __future__ import annotations

import contextlib
import io
import re
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

INK, FAINT = "#010203", "#040506"  # placeholders for the colours of the page
# Hues that colour-blind readers can distinguish, on white and on black. Markers and dashes work without colour.
COLOURS = ("#0a7abf", "#d55e00", "#009e73", "#c7669e", "#b58900", "#3fa7dd", "#8a6fd1", INK)
MARKERS = ("o", "s", "^", "D", "v", "P", "X", "*")
DASHES: tuple[Any, ...] = ("-", (0, (5, 1.5)), (0, (1, 1)), (0, (6, 1, 1, 1)), (0, (3, 1)))
_REPLACED = {INK: "currentColor", FAINT: "var(--faint)"}

_STYLE: dict[Any, Any] = {
    "svg.fonttype": "none",
    "svg.hashsalt": "dynaviz",
    "font.family": "sans-serif",
    "font.size": 9.0,
    "axes.titlesize": 10.0,
    "axes.titleweight": "bold",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.axisbelow": True,
    "axes.grid": True,
    "grid.color": FAINT,
    "grid.linewidth": 0.5,
    "legend.frameon": False,
    "lines.linewidth": 1.6,
    **dict.fromkeys(("text.color", "axes.edgecolor", "axes.labelcolor", "xtick.color", "ytick.color"), INK),
}

WIDTHS = {1: 6.0, 2: 11.0, 3: 12.0, 4: 12.5}  # inches, by panels per row
POINTS = 98  # pixels of the page per inch


class Palette:
    """A colour, a marker and a dash for each method, the same in all figures of a report."""

    def __init__(self, methods: Sequence[str]) -> None:
        self._at = {method: k for k, method in enumerate(sorted(set(methods)))}

    def line(self, method: str) -> dict[str, Any]:
        """Style of a method's line."""
        point = self.point(method)
        return {**point, "markersize": 0.65 * point["markersize"], "linestyle": DASHES[self._at[method] % len(DASHES)]}

    def point(self, method: str) -> dict[str, Any]:
        """Style of a method's marker."""
        k = self._at[method]
        marker = MARKERS[(k + k // len(MARKERS)) % len(MARKERS)]
        return {"color": COLOURS[k % len(COLOURS)], "marker": marker, "markersize": 11 if marker == "*" else 8}


@contextlib.contextmanager
def style() -> Iterator[None]:
    """Matplotlib settings shared by all figures."""
    import matplotlib as mpl

    with mpl.rc_context():
        mpl.rcdefaults()
        mpl.rcParams.update(_STYLE)
        yield


def panels(count: int, height: float = 3.3, across: int = 4) -> tuple[Figure, list[Axes]]:
    """A figure with a grid of panels.

    Args:
        count: number of panels.
        height: height of a row, inches.
        across: maximum number of panels per row.
    """
    from matplotlib.figure import Figure

    columns = min(count, across)
    rows = -(-count // columns)
    wide = WIDTHS[columns]
    figure = Figure((wide, height * rows), layout="constrained")
    figure.patch.set_alpha(0)
    grid = figure.subplots(rows, columns, squeeze=False).ravel()
    for axes in grid:
        axes.patch.set_alpha(0)
    for axes in grid[count:]:
        axes.set_axis_off()
    return figure, list(grid[:count])


def svg(figure: Figure, name: str, title: str) -> str:
    """A figure as an SVG element of a page. Equal figures give equal texts.

    Args:
        figure: the figure to draw.
        name: a name that is unique in the page.
        title: description for screen readers.
    """
    from html import escape

    import matplotlib as mpl

    text, width = io.StringIO(), round(POINTS * figure.get_figwidth())
    with mpl.rc_context({"svg.hashsalt": name}):
        figure.savefig(text, format="svg", metadata={"Date": None, "Creator": None, "Format": None, "Type": None})
    body = text.getvalue()
    body = body[body.index("<svg") :]
    body = re.sub(r"\s*<metadata>.*?</metadata>", "", body, flags=re.DOTALL)
    body = re.sub(r'(\bid="|url\(#|xlink:href="#)', rf"\g<1>{name}-", body)
    body = re.sub(
        r'<svg [^>]*?(viewBox="[^"]*")[^>]*>',
        rf'<svg \1 style="max-width: {width}px" role="img" aria-labelledby="{name}-title">',
        body,
        count=1,
    )
    body = body.replace("xlink:href", "href")
    for placeholder, own in _REPLACED.items():
        body = body.replace(placeholder, own)
    head, _, rest = body.partition(">")
    return f'{head}><title id="{name}-title">{escape(title)}</title>{rest}'.strip()
