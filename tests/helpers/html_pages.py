"""A parser for the pages of reports."""

from __future__ import annotations

from html.parser import HTMLParser
from typing import Any


class Page(HTMLParser):
    """Tables, ids, links and loaded resources; fails if tags do not close."""

    VOID = frozenset({"meta", "img", "br", "link", "hr", "input"})

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.ids: list[str] = []
        self.links: list[str] = []
        self.images: list[dict[str, str | None]] = []
        self.tables: dict[str, list[list[dict[str, Any]]]] = {}
        self.loaded: list[str] = []
        self.words: list[str] = []
        self.feed(text)
        self.close()
        assert not self.open

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = dict(attrs)
        if tag not in self.VOID:
            self.open.append(tag)
        self.ids += [given["id"] or ""] if "id" in given else []
        if tag == "a":
            self.links.append(given["href"] or "")
        elif "src" in given or "href" in given:
            self.loaded.append(given.get("src") or given.get("href") or "")
        if tag == "img":
            self.images.append(given)
        if tag == "table":
            self.rows = self.tables.setdefault(given["data-table"] or "", [])
        if tag == "tr":
            self.rows.append([])
        if tag in ("td", "th"):
            self.rows[-1].append({**given, "text": "", "bold": False})
        if tag == "strong" and "table" in self.open:
            self.rows[-1][-1]["bold"] = True

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.handle_starttag(tag, attrs)
        if tag not in self.VOID:
            self.open.pop()

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag, tag

    def handle_data(self, data: str) -> None:
        if not {"style", "script"} & set(self.open):
            self.words.append(data)
        if {"td", "th"} & set(self.open):
            self.rows[-1][-1]["text"] += data

    @property
    def text(self) -> str:
        return " ".join(" ".join(self.words).split())

    def body(self, name: str) -> list[list[dict[str, Any]]]:
        """Rows of a table without its head."""
        return [row for row in self.tables[name] if row[0].get("scope") == "row"]


def markdown_table(text: str, title: str) -> list[dict[str, str]]:
    lines = text.split(f"## {title}\n\n")[1].split("\n\n")[0].replace("\\", "").splitlines()
    fields = [[field.strip() for field in line.strip("|").split(" | ")] for line in lines]
    return [dict(zip(fields[0], row, strict=True)) for row in fields[2:]]
