"""What mkdocs needs beyond docs/.

READMEs as pages, their links, a page for each method, and formulas.

The generated parts of the pages are committed; ``docs/generate.py`` writes them.
"""

from __future__ import annotations

import posixpath
import re
from pathlib import Path

import generate  # mkdocs puts this folder on the path while it loads the hooks
from latex2mathml.converter import convert
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

ROOT = Path(__file__).resolve().parent.parent
BROUGHT = {  # files outside docs/, and the pages they become
    "README.md": "readme.md",
    "recordings/README.md": "recordings.md",
    "eval/README.md": "evaluation.md",
    "benchmarks/README.md": "benchmarks.md",
    "CHANGELOG.md": "changes.md",
}
LINK = re.compile(r"(?<=\]\()(?!https?:|mailto:|#)([^)\s#]+)(#[^)\s]*)?(?=\))")


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Add a fence that turns formulas into MathML, and the methods' pages to the navigation."""
    fence = {
        "name": "math",
        "class": "math",
        "format": lambda source, *_, **__: convert(source, display="block"),
    }
    config.mdx_configs["pymdownx.superfences"] = {"custom_fences": [fence]}
    entry = next(item["Methods"] for item in config.nav or [] if "Methods" in item)
    entry[1:1] = dict.fromkeys(f"methods/{generate.page(name).name}" for name in generate.methods())
    return config


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the READMEs, and a generated page for each built-in method that has none."""
    for source, page in BROUGHT.items():
        files.append(
            File.generated(config, page, content=(ROOT / source).read_text(encoding="utf-8"))
        )
    for name, kind in generate.methods().items():
        page = f"methods/{generate.page(name).name}"
        if files.get_file_from_path(page) is None:
            files.append(File.generated(config, page, content=generate.new_page(kind)))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Point links that leave docs/ to the pages that the READMEs became."""
    uri = page.file.src_uri
    home = next((source for source, brought in BROUGHT.items() if brought == uri), f"docs/{uri}")
    return relinked(markdown, home, uri, files)


def relinked(markdown: str, home: str, uri: str, files: Files) -> str:
    """Turn links between files of the repository into links between pages.

    Drop links to files without a page.

    Args:
        markdown: a page.
        home: its file in the repository.
        uri: its path in the site.
        files: all files of the site.
    """

    def moved(found: re.Match[str]) -> str:
        target = posixpath.normpath(posixpath.join(posixpath.dirname(home), found[1]))
        page = BROUGHT.get(target) or target.removeprefix("docs/")
        known = files.get_file_from_path(page) if target in BROUGHT or page != target else None
        return (
            posixpath.relpath(page, posixpath.dirname(uri) or ".") + (found[2] or "")
            if known
            else ABSENT
        )

    ABSENT = "\0"
    linked = LINK.sub(moved, markdown)
    return re.sub(rf"!?\[((?:[^\[\]]|\[[^\]]*\])*)\]\({ABSENT}\)", r"\1", linked)
