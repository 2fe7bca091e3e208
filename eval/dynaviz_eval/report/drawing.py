"""Style of figures: a colour, a marker and a dash for each method, and SVG for light and dark
pages.
"""

from __future__ import annotations

import contextlib
import io
import re
import zlib
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from dynaviz.colours import method_colour, web
from dynaviz.contracts import registry
from dynaviz.errors import MissingDependency

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# placeholders for the colours of the page
INK = "#010203"
FAINT = "#040506"
MARKERS = ("o", "s", "^", "D", "v", "P", "X", "*", "p")
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
    **dict.fromkeys(
        ("text.color", "axes.edgecolor", "axes.labelcolor", "xtick.color", "ytick.color"), INK
    ),
}

WIDTH = 4.6  # inches: width of a panel
POINTS = 150  # pixels of the page per inch, at most


def line(method: str) -> dict[str, Any]:
    """Style of a method's line, the same in every report."""
    look = mark(method)
    return {
        **look,
        "markersize": 0.65 * look["markersize"],
        "linestyle": DASHES[_number(method) % len(DASHES)],
    }


def mark(method: str) -> dict[str, Any]:
    """Style of a method's marker, the same in every report."""
    marker = MARKERS[_number(method) % len(MARKERS)]
    return {
        "color": web(method_colour(method)),
        "marker": marker,
        "markersize": 11 if marker == "*" else 8,
    }


def _number(method: str) -> int:
    """A number for each method; different ones for those that come with dynaviz."""
    known = [each.name for each in registry.handles("methods") if each.distribution == "dynaviz"]
    return known.index(method) if method in known else zlib.crc32(method.encode())


@contextlib.contextmanager
def style() -> Iterator[None]:
    """Matplotlib settings shared by all figures."""
    try:
        import jinja2  # noqa: F401  # the page needs it after the figures
        import matplotlib as mpl
    except ModuleNotFoundError:
        raise MissingDependency(
            "reports need matplotlib and jinja2. Install them with: pip install matplotlib jinja2"
        ) from None
    with mpl.rc_context():
        mpl.rcdefaults()
        mpl.rcParams.update(_STYLE)
        yield


def panel(height: float = 3.2) -> tuple[Figure, Axes]:
    """A figure with one panel, of a width that stays legible on a phone; ``height`` in inches."""
    from matplotlib.figure import Figure

    figure = Figure((WIDTH, height), dpi=72, layout="constrained")
    figure.patch.set_alpha(0)
    axes = figure.subplots()
    axes.patch.set_alpha(0)
    return figure, axes


def svg(figure: Figure, name: str, title: str) -> str:
    """A figure as an SVG element of a page. Equal figures give equal texts.

    Args:
        figure: the figure to draw.
        name: a name that is unique in the page.
        title: description for screen readers.
    """
    from html import escape

    import matplotlib as mpl

    text = io.StringIO()
    width = round(POINTS * figure.get_figwidth())
    with mpl.rc_context({"svg.hashsalt": name}):
        figure.savefig(
            text,
            format="svg",
            metadata={"Date": None, "Creator": None, "Format": None, "Type": None},
        )
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
