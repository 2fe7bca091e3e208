"""Write the generated parts of the pages: what the code knows about each method and protocol.

    python docs/generate.py            # bring all pages up to date
    python docs/generate.py --check    # change nothing; list the pages that are out of date, and
                                       # exit with 1

A page marks each part with a pair of comments:

    <!-- generated: parameters -->
    ...
    <!-- end -->

The name is one of SECTIONS on the page of a method (``docs/methods/NAME.md``), or one of TABLES on
any page. On a page of several methods, a section names its method, as in ``parameters:octomap_gf``.
Text outside the markers is never touched. A built-in method without a page gets one with every
section. ``docs/draw.py`` measures the numbers in ``failures`` and draws its picture.
"""

from __future__ import annotations

import dataclasses
import inspect
import json
import re
import sys
import textwrap
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import real_tables
from griffe import Docstring, DocstringSectionAttributes
from real_tables import methods, table

from dynaviz.contracts import registry
from dynaviz.contracts.options import options_of
from dynaviz.diagnosis.sampling import measured
from dynaviz.runs.options import RunOptions
from dynaviz.sources.options import SequenceOptions

DOCS = Path(__file__).resolve().parent
ROOT = DOCS.parent
PICTURES = "../pictures"
BLOCK = re.compile(r"^<!-- generated: (\S+) -->\n.*?^<!-- end -->$", re.M | re.S)
COMMAND = "python docs/generate.py"
SHARED_PAGES = {"octomap_g": "octomap", "octomap_gf": "octomap"}
WORST = 3  # causes of lost SA or DA on the page of a method


def pages() -> dict[Path, str]:
    """The text that each page with generated parts should have, including pages that do not exist
    yet.

    Raises:
        ValueError: a page marks a part that nothing generates.
    """
    paths = {*DOCS.rglob("*.md"), *ROOT.glob("*.md"), *ROOT.glob("*/README.md")}
    texts = {path: path.read_text(encoding="utf-8") for path in sorted(paths)}
    texts |= {
        page(name): new_page(kind) for name, kind in methods().items() if page(name) not in texts
    }
    return {path: filled(text, path) for path, text in texts.items() if BLOCK.search(text)}


def stale() -> list[Path]:
    """Pages whose generated parts differ from what the code says now."""
    return [
        path
        for path, text in pages().items()
        if not path.exists() or path.read_text(encoding="utf-8") != text
    ]


def page(name: str) -> Path:
    """The page of a method."""
    return DOCS / f"methods/{SHARED_PAGES.get(name, name)}.md"


def new_page(kind: Any) -> str:
    """A page with every section and no prose, for a method that has no page."""
    blocks = "\n\n".join(f"<!-- generated: {section} -->\n<!-- end -->" for section in SECTIONS)
    return filled(f"# {kind.info.title}\n\n{blocks}\n", page(kind.info.name))


def filled(text: str, path: Path) -> str:
    """The text of a page with its generated parts up to date.

    Args:
        text: the page in Markdown.
        path: its file, which decides which method the sections describe unless they name one.
    """

    def block(found: re.Match[str]) -> str:
        name = found[1]
        section, _, method = name.partition(":")
        kind = methods().get(method or path.stem) if path.parent == DOCS / "methods" else None
        if kind is not None and section in SECTIONS:
            content = SECTIONS[section](kind)
        elif name in TABLES:
            content = TABLES[name]()
        else:
            raise ValueError(
                f"{path.relative_to(ROOT)}: cannot generate {name!r}. Give a section or a table."
            )
        return f"<!-- generated: {name} -->\n\n{content}\n\n<!-- end -->"

    return BLOCK.sub(block, text)


@cache
def measurements() -> dict[str, Any]:
    """What docs/draw.py measured."""
    known: dict[str, Any] = json.loads((DOCS / "methods/measured.json").read_text(encoding="utf-8"))
    return known


def overview() -> str:
    """All methods: whether they need a prior map, and their scores on the scene of docs/draw.py."""
    measured = measurements()["methods"]
    rows = []
    for name, kind in methods().items():
        scores = measured.get(name, {}).get("metrics", {})
        rows.append(
            (
                f"[{kind.info.title}]({page(name).name})",
                f"`{name}`",
                kind.info.paper,
                "yes" if kind.info.needs_map else "no",
                len(dataclasses.fields(kind.Params)),
                *(f"{scores[key]:.2f}" if key in scores else "" for key in ("SA", "DA", "AA")),
            )
        )
    return table(("method", "name", "paper", "prior map", "parameters", "SA", "DA", "AA"), rows)


def protocols() -> str:
    """What each protocol counts."""
    infos = [protocol.info for protocol in registry.loadable("protocols").values()]
    rows = (
        (
            f"**{info.title}**, `{info.name}`",
            info.counts,
            info.ignores,
            info.combines,
            ", ".join(info.scores),
            info.source,
        )
        for info in infos
    )
    return table(("protocol", "counts", "leaves out", "combines", "scores", "source"), rows)


def options() -> str:
    """The keyword arguments of Python functions that open a sequence or run a method."""
    rows = (
        (f"`{each.name}`", f"`{each.annotation}`", f"`{each.default!r}`", each.words)
        for each in options_of(SequenceOptions, RunOptions)
    )
    return table(("keyword", "type", "default", "meaning"), rows)


def sampling() -> str:
    """DA of each method by scans that see a place and by rings, one table for each drive."""
    rows = measured()
    names = sorted({row["method"] for row in rows})
    tables = []
    for drive in sorted({row["drive"] for row in rows}):
        found = {
            (row["method"], -row["rings"], -row["looks"]): f"{row['DA']:.0f}"
            for row in rows
            if row["drive"] == drive
        }
        columns = sorted({(rings, seen) for _, rings, seen in found})
        head = ("method", *(f"{-seen} scans, {-rings} rings" for rings, seen in columns))
        filled_in = (
            (f"`{name}`", *(found.get((name, *column), "") for column in columns)) for name in names
        )
        tables.append(f"{real_tables.title(drive)}:\n\n{table(head, filled_in)}")
    return "\n\n".join(tables)


TABLES: dict[str, Callable[[], str]] = {
    each.__name__: each for each in (overview, protocols, options, sampling, *real_tables.TABLES)
}


def facts(kind: Any) -> str:
    """Paper, prior map, source file, and the command that runs the method."""
    info = kind.info
    needs = "needs the raw map before the first scan" if info.needs_map else "needs no prior map"
    file = Path(inspect.getsourcefile(kind) or "").relative_to(ROOT)
    return (
        f"{info.paper} · {needs} · [`{file}`](../../{file})\n\n```sh\ndynaviz run {info.name} "
        "path/to/sequence\n```"
    )


def algorithm(kind: Any) -> str:
    """The algorithm box: the indented block of the module's docstring."""
    text = inspect.getdoc(inspect.getmodule(kind)) or ""
    block = re.search(r"(?:^ {4}.*\n)(?:^(?: {4}.*)?\n)*", text, re.M)
    return f"```text\n{textwrap.dedent(block[0]).strip()}\n```" if block else ""


def parameters(kind: Any) -> str:
    """The fields of Params: defaults, and meanings from the docstrings."""
    meanings: dict[str, str] = {}
    for parent in reversed(kind.Params.__mro__):
        for section in Docstring(inspect.getdoc(parent) or "").parse("google"):
            if isinstance(section, DocstringSectionAttributes):
                meanings |= {
                    item.name: " ".join(item.description.split()) for item in section.value
                }
    rows = (
        (f"`{field.name}`", f"`{field.default}`", meanings.get(field.name, ""))
        for field in dataclasses.fields(kind.Params)
    )
    return table(("parameter", "default", "meaning"), rows)


def reasons(kind: Any) -> str:
    """Why points are kept or removed."""
    return table(
        ("reason", "meaning"),
        ((f"`{reason.name}`", reason.meaning) for reason in kind.info.reasons),
    )


def failures(kind: Any) -> str:
    """Picture, scores and the costliest causes of wrong points, on the scene of docs/draw.py."""
    name = kind.info.name
    known = measurements()
    if name not in known["methods"]:
        return ""
    run = known["methods"][name]
    scores = ", ".join(f"{key} {run['metrics'][key]:.2f}" for key in ("SA", "DA", "AA"))
    return (
        f"On `{known['scene']}`, {known['frames']} frames, default parameters: {scores}. "
        f"Lost SA: {costs(run['causes'], 'false_positive', run['static'])}. "
        f"Lost DA: {costs(run['causes'], 'false_negative', run['dynamic'])}.\n\n"
        f"![Map of {kind.info.title} with its wrong points, and a state]({PICTURES}/{name}.jpg)\n\n"
        f"Left: wrong points of the map, kept in orange and removed in yellow. "
        f"Right: `{run['state']}` in frame {run['frame']}."
    )


def costs(causes: dict[str, dict[str, dict[str, int]]], kind: str, total: int) -> str:
    """The costliest causes of one kind of wrong points, with the share of all points that they
    cost.
    """
    worst = sorted(causes.get(kind, {}).items(), key=lambda cause: -cause[1]["points"])[:WORST]
    return (
        ", ".join(f"{cause} {100 * counted['points'] / total:.2f} %" for cause, counted in worst)
        or "nothing"
    )


SECTIONS: dict[str, Callable[[Any], str]] = {
    section.__name__: section for section in (facts, algorithm, parameters, reasons, failures)
}


def main(arguments: list[str]) -> int:
    """Update the pages, or with ``--check`` only list those that are out of date."""
    changed = stale()
    if arguments == ["--check"]:
        for path in changed:
            print(f"{path.relative_to(ROOT)}: out of date. Run {COMMAND}.", file=sys.stderr)
        return int(bool(changed))
    if arguments:
        print(__doc__)
        return 2
    texts = pages()
    for path in changed:
        path.write_text(texts[path], encoding="utf-8")
        print(f"{path.relative_to(ROOT)}: updated")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
