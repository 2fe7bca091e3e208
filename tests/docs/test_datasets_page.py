"""docs/datasets.md describes every data set."""

from __future__ import annotations

import re
from pathlib import Path

from dynaviz.contracts import registry
from dynaviz.sources.datasets.download import SEQUENCES

PAGE = (Path(__file__).resolve().parents[2] / "docs/datasets.md").read_text(encoding="utf-8")


def rows(first: str) -> list[list[str]]:
    """The cells of the table whose head begins like this."""
    table = PAGE[PAGE.index(first) :].split("\n\n")[0]
    return [
        [cell.strip(" `") for cell in line.strip("|").split("|")] for line in table.splitlines()
    ]


def test_every_data_set_has_its_place() -> None:
    for handle in registry.handles("datasets"):
        assert f"(`{handle.name}`)\n" in PAGE or f" {handle.name}:" in PAGE, handle.name


def test_every_download_is_described() -> None:
    _, _, *body = rows("| name | what | frames |")
    assert {cells[0]: int(cells[2]) for cells in body} == {
        name: remote.frames for name, remote in SEQUENCES.items()
    }
    assert {cells[0] for cells in body if "no ground truth" in cells[4]} == {
        name for name, remote in SEQUENCES.items() if not remote.labelled
    }


def test_links_inside_the_page_lead_somewhere() -> None:
    headings = [line.lstrip("# ") for line in PAGE.splitlines() if line.startswith("#")]
    anchors = {re.sub(r"[^\w -]", "", heading.lower()).replace(" ", "-") for heading in headings}
    for target in re.findall(r"\]\(#([^)]+)\)", PAGE):
        assert target in anchors
    for target in re.findall(r"\]\((\.\./[^)#]+)\)", PAGE):
        assert (Path(__file__).resolve().parents[2] / "docs" / target).exists(), target
