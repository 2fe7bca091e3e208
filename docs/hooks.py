"""What the site takes from elsewhere: READMEs as pages, and on methods' pages all that their code tells.

A page of a method, ``docs/methods/NAME.md``, holds prose and, on lines of their own, names of SECTIONS in braces, as
``{{ parameters }}``; a method without a page gets one with all sections. ``docs/draw.py`` writes the numbers and the
picture of ``{{ failures }}``. Any page may hold ``{{ PATH }}``, and gets the text of that file of the repository.
"""

from __future__ import annotations

import dataclasses
import inspect
import json
import posixpath
import re
import textwrap
from collections.abc import Callable, Iterable
from functools import cache
from pathlib import Path
from typing import Any, get_type_hints

from griffe import Docstring, DocstringSectionAttributes
from latex2mathml.converter import convert
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

from dynaviz import registry

DOCS = Path(__file__).parent
ROOT = DOCS.parent
BROUGHT = {  # files outside docs/, and the pages they become
    "README.md": "readme.md",
    "recordings/README.md": "recordings.md",
    "methods/README.md": "methods/notes.md",
    "eval/README.md": "evaluation.md",
    "benchmarks/README.md": "benchmarks.md",
    "CHANGELOG.md": "changes.md",
}
LINK = re.compile(r"(?<=\]\()(?!https?:|mailto:|#)([^)\s#]+)(#[^)\s]*)?(?=\))")


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """A fence for formulas, which become MathML, and a place for each method's page."""
    fence = {"name": "math", "class": "math", "format": lambda source, *_, **__: convert(source, display="block")}
    config.mdx_configs["pymdownx.superfences"] = {"custom_fences": [fence]}
    entry = next(item["Methods"] for item in config.nav or [] if "Methods" in item)
    entry[1:1] = [f"methods/{name}.md" for name in methods()]
    return config


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """The pages that are brought, and those of methods that nobody wrote about."""
    for source, page in BROUGHT.items():
        files.append(File.generated(config, page, content=(ROOT / source).read_text(encoding="utf-8")))
    for name, kind in methods().items():
        if files.get_file_from_path(f"methods/{name}.md") is None:
            sections = "\n\n".join(f"{{{{ {section} }}}}" for section in SECTIONS)
            files.append(File.generated(config, f"methods/{name}.md", content=f"# {kind.info.title}\n\n{sections}\n"))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Fill in the sections, then have links that leave docs/ lead to the pages that were brought."""
    uri = page.file.src_uri
    if uri == "methods/index.md":
        markdown = markdown.replace("{{ methods }}", overview())
    elif uri.startswith("methods/") and (kind := methods().get(Path(uri).stem)):
        markdown = re.sub(r"^\{\{ (\w+) \}\}$", lambda found: SECTIONS[found[1]](kind), markdown, flags=re.M)
    markdown = re.sub(
        r"^\{\{ (\S+/\S+) \}\}$", lambda found: (ROOT / found[1]).read_text().strip(), markdown, flags=re.M
    )
    home = next((source for source, brought in BROUGHT.items() if brought == uri), f"docs/{uri}")
    return relinked(markdown, home, uri, files)


def relinked(markdown: str, home: str, uri: str, files: Files) -> str:
    """Links as they are in the repository, for the site; what is no page there loses its link and keeps its words.

    Args:
        markdown: a page.
        home: its file in the repository.
        uri: its place in the site.
        files: of the site.
    """

    def moved(found: re.Match[str]) -> str:
        target = posixpath.normpath(posixpath.join(posixpath.dirname(home), found[1]))
        page = BROUGHT.get(target) or target.removeprefix("docs/")
        known = files.get_file_from_path(page) if target in BROUGHT or page != target else None
        return posixpath.relpath(page, posixpath.dirname(uri) or ".") + (found[2] or "") if known else ABSENT

    ABSENT = "\0"
    linked = LINK.sub(moved, markdown)
    return re.sub(rf"!?\[((?:[^\[\]]|\[[^\]]*\])*)\]\({ABSENT}\)", r"\1", linked)


@cache
def methods() -> dict[str, Any]:
    """The methods that come with dynaviz, by name."""
    handles = (handle for handle in registry.handles("methods") if handle.package == "dynaviz_methods")
    return {handle.name: handle.load() for handle in handles}


def table(head: Iterable[str], rows: Iterable[Iterable[object]]) -> str:
    """A Markdown table."""
    lines = [list(head), *([str(cell).replace("|", "\\|") for cell in row] for row in rows)]
    lines.insert(1, ["---"] * len(lines[0]))
    return "\n".join("| " + " | ".join(cells) + " |" for cells in lines)


def overview() -> str:
    """All methods: what they need, and how they did on the pages' scene."""
    measured = measurements()["methods"]
    rows = []
    for name, kind in methods().items():
        scores = measured.get(name, {}).get("metrics", {})
        rows.append(
            (
                f"[{kind.info.title}]({name}.md)",
                f"`{name}`",
                kind.info.paper,
                "yes" if kind.info.needs_map else "no",
                len(dataclasses.fields(kind.Params)),
                *(f"{scores[key]:.2f}" if key in scores else "" for key in ("SA", "DA", "AA")),
            )
        )
    return table(("method", "name", "paper", "prior map", "parameters", "SA", "DA", "AA"), rows)


def facts(kind: Any) -> str:
    """Name, paper, needs."""
    info = kind.info
    needs = "needs the raw map before the first scan" if info.needs_map else "needs no prior map"
    file = inspect.getsourcefile(kind)
    return (
        f"{info.paper} · {needs} · `{Path(file or '').relative_to(ROOT)}`\n\n"
        f"```sh\ndynaviz run {info.name} path/to/sequence\n```"
    )


def algorithm(kind: Any) -> str:
    """The algorithm box: the indented block of the module's docstring."""
    text = inspect.getdoc(inspect.getmodule(kind)) or ""
    block = re.search(r"(?:^ {4}.*\n)(?:^(?: {4}.*)?\n)*", text, re.M)
    return f"```text\n{textwrap.dedent(block[0]).strip()}\n```" if block else ""


def parameters(kind: Any) -> str:
    """The fields of Params: defaults, types, and what the docstrings say of them."""
    told: dict[str, str] = {}
    for parent in reversed(kind.Params.__mro__):
        for section in Docstring(inspect.getdoc(parent) or "").parse("google"):
            if isinstance(section, DocstringSectionAttributes):
                told |= {item.name: " ".join(item.description.split()) for item in section.value}
    hints = get_type_hints(kind.Params)
    rows = (
        (f"`{field.name}`", f"`{field.default}`", named(hints[field.name]), told.get(field.name, ""))
        for field in dataclasses.fields(kind.Params)
    )
    return (
        table(("parameter", "default", "type", "meaning"), rows)
        + "\n\nSet them with `--set KEY=VALUE`, a preset or a file; "
        + f"`dynaviz config {kind.info.name}` shows which counts."
    )


def named(hint: Any) -> str:
    """A type as a reader would say it."""
    return "numbers" if getattr(hint, "__origin__", None) is tuple else str(getattr(hint, "__name__", hint))


def states(kind: Any) -> str:
    """What a recording shows of the method."""
    rows = ((f"`{state.name}`", state.kind.__name__, state.meaning) for state in kind.info.emits)
    return table(("state", "drawn as", "meaning"), rows)


def reasons(kind: Any) -> str:
    """Why a point was kept or removed, and what is to blame where that is wrong."""
    rows = ((f"`{reason.name}`", reason.meaning, reason.cause or "") for reason in kind.info.reasons)
    return table(("reason", "meaning", "blamed where wrong"), rows)


def failures(kind: Any) -> str:
    """Picture, causes by count and the costliest cases on the pages' scene."""
    name, known = kind.info.name, measurements()
    if name not in known["methods"]:
        return ""
    run, sides = known["methods"][name], (("false_positive", "removed", "SA"), ("false_negative", "kept", "DA"))
    totals = {"SA": run["static"], "DA": run["dynamic"]}
    causes = [
        (word, cause, f"{counted['points']:,}", f"{100 * counted['points'] / totals[score]:.2f} % {score}")
        for kind_, word, score in sides
        for cause, counted in run["causes"].get(kind_, {}).items()
    ]
    scores = ", ".join(f"{key} {run['metrics'][key]:.2f}" for key in ("SA", "DA", "AA"))
    cases = "\n".join(
        f"{position}. -{case['cost']:.2f} % {'SA' if case['kind'] == 'false_positive' else 'DA'}: {case['sentence']}"
        for position, case in enumerate(run["cases"], 1)
    )
    return (
        f"On `{known['scene']}`, {known['frames']} frames, default parameters: {scores}.\n\n"
        f"![The map of {kind.info.title} with its wrong points, and its state]({PICTURES}/{name}.jpg)\n\n"
        f"Left, the map of the run: grey and blue are right, orange moved and was kept, yellow stood and was removed. "
        f"Right, the state `{run['state']}` in frame {run['frame']}.\n\n"
        + table(("wrongly", "cause", "points", "costs"), causes)
        + f"\n\nThe costliest cases:\n\n{cases}"
    )


PICTURES = "../pictures"
SECTIONS: dict[str, Callable[[Any], str]] = {
    section.__name__: section for section in (facts, algorithm, parameters, states, reasons, failures)
}


@cache
def measurements() -> dict[str, Any]:
    """What docs/draw.py measured."""
    known: dict[str, Any] = json.loads((DOCS / "methods/measured.json").read_text(encoding="utf-8"))
    return known
