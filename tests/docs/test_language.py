"""Pages and help texts avoid phrases that read like a translation; CONTRIBUTING.md has the rule."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import typer

from dynaviz.cli import app

ROOT = Path(__file__).resolve().parents[2]
PAGES = sorted(
    {
        *ROOT.glob("*.md"),
        *ROOT.glob("*/README.md"),
        *ROOT.glob("examples/*/*.md"),
        *ROOT.glob("docs/**/*.md"),
        *ROOT.glob("docs/**/*.ipynb"),
    }
)
IDIOMS = {  # what to avoid, and what to write
    r"\b(is|are|was|were) told\b|\btold (of|by)\b": "is reported, shows, states, receives",
    r"\bmends?\b": "fix",
    r"\bfell\b|what falls\b": "dropped, failed",
    r"\bbeside\b": "next to, in addition to, compared with",
    r"\bseldom\b": "rarely",
    r"\bhow manieth\b": "every N-th",
    r"\b(that|which) (is|are) none\b|\bare none of\b": "invalid, not an X",
    r"\bis no [a-z]+ (that|of)\b": "is not a",
    r"\bwhat (stands|stood|moves|moved)\b": "static points, dynamic points",
    r"\bwhoever\b|\bwherefrom\b": "name the subject",
    r"\bnobody (knows|looks|else)\b": "unknown; name the subject",
    r"\bcounts? nowhere\b": "is not scored",
    r"\bfor ever\b": "always",
    r"\bhears of\b": "receives",
    r"\b(is|are) asked for\b": "is requested, is needed",
    r"\bof others? than\b": "from a different ... than",
    r"\bnow the one\b|\bthe one or the other\b": "name both",
    r"\bwould else\b|, else\b|\bor else\b": "otherwise",
    r"\bnor (can|could|do|does|is|are)\b": "cannot, does not, is not",
    r"\brefuse[sd]?\b": "rejected",
    r"\bno single [a-z]+ (here|there)\b": "not individually",
}
IDIOM = {re.compile(idiom.replace(" ", r"\s+"), re.I): better for idiom, better in IDIOMS.items()}
CODE = re.compile(
    r"^ *```.*?^ *```|`[^`\n]*(?:\n[^`\n]+)?`", re.M | re.S
)  # fenced blocks and spans
COMMAND: Any = typer.main.get_command(app)
COMMANDS: dict[str, Any] = {
    "dynaviz": COMMAND,
    **{f"dynaviz {name}": each for name, each in COMMAND.commands.items()},
}


def found(text: str, place: str) -> Iterator[str]:
    """A line ``place:line: phrase`` for each idiom in a text.

    Code blocks and code spans are skipped.
    """
    prose = CODE.sub(lambda code: re.sub(r"[^\n]", " ", code[0]), text)
    for idiom, better in IDIOM.items():
        for match in idiom.finditer(prose):
            line = prose.count("\n", 0, match.start()) + 1
            yield f"{place}:{line}: '{' '.join(match[0].split())}'. Write: {better}."


def texts(name: str, command: Any) -> Iterator[tuple[str, str]]:
    """The help texts of a command with their places.

    Its own, and those of its arguments and options.
    """
    yield name, f"{command.help or ''}\n{command.epilog or ''}"
    for parameter in command.params:
        opts = "/".join((*parameter.opts, *parameter.secondary_opts))
        yield (
            f"{name} {opts}",
            f"{getattr(parameter, 'help', None) or ''}\n{parameter.metavar or ''}",
        )


@pytest.mark.parametrize("page", PAGES, ids=lambda path: str(path.relative_to(ROOT)))
def test_pages_are_in_plain_english(page: Path) -> None:
    problems = list(found(page.read_text(encoding="utf-8"), str(page.relative_to(ROOT))))
    assert not problems, "\n".join(problems)


@pytest.mark.parametrize("name", COMMANDS)
def test_help_texts_are_in_plain_english(name: str) -> None:
    problems = [
        problem for place, text in texts(name, COMMANDS[name]) for problem in found(text, place)
    ]
    assert not problems, "\n".join(problems)


def test_idioms_are_found_with_their_line_but_not_in_code() -> None:
    text = "Fine.\n\n```sh\ndynaviz run seldom SEQ\n```\n\nThe plug-in `seldom` is\ntold of it.\n"
    assert [problem.split(". Write")[0] for problem in found(text, "page.md")] == [
        "page.md:7: 'is told'"
    ]
    assert len(PAGES) > 25
    assert len(COMMANDS) > 15
