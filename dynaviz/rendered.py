"""What rich can print, as text for ``print`` and as HTML for notebooks."""

from __future__ import annotations

import io
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import Console, RenderableType


def text_of(content: RenderableType, width: int) -> str:
    """Plain text.

    Args:
        content: what is printed.
        width: of a line, in characters.
    """
    return _printed(content, width).export_text()


def html_of(content: RenderableType, width: int) -> str:
    """A ``pre`` element with styles of its own.

    Args:
        content: what is printed.
        width: of a line, in characters.
    """
    return _printed(content, width).export_html(inline_styles=True, code_format="<pre>{code}</pre>")


def _printed(content: RenderableType, width: int) -> Console:
    from rich.console import Console

    console = Console(file=io.StringIO(), record=True, width=width)
    console.print(content)
    return console
