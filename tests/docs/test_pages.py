"""The pages: the site builds without a warning, and the commands on it work.

A block ``console`` is tried: its lines that begin with ``$`` run one after another, in a folder of
the page's own that has the demo's street.
"""

from __future__ import annotations

import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from dynaviz.contracts import registry

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
FRAMES = 5
COMMANDS = {
    page.name: [
        line.removeprefix("$ ")
        for block in re.findall(
            r"^```console\n(.*?)^```", page.read_text(encoding="utf-8"), re.M | re.S
        )
        for line in block.splitlines()
        if line.startswith("$ ")
    ]
    for page in sorted(DOCS.rglob("*.md"))
}
Site = Callable[[str], str]


@pytest.fixture(scope="session")
def street(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The demo's street, shorter."""
    from dynaviz.synthetic.simulate import simulate

    return simulate("demo", tmp_path_factory.mktemp("demo") / "street", frames=FRAMES)


@pytest.mark.parametrize(
    "page",
    [
        pytest.param(
            name,
            marks=pytest.mark.slow
            if name in ("tutorial.md", "comparing.md", "other_programs.md")
            else [],
        )
        for name, commands in COMMANDS.items()
        if commands
    ],
)
def test_commands_work(
    page: str,
    street: Path,
    run_command: Callable[..., tuple[int, str, str]],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    shutil.copytree(street, tmp_path / "recordings/demo/street")
    monkeypatch.chdir(tmp_path)
    for command in COMMANDS[page]:
        program, *words = shlex.split(command, comments=True)
        assert program == "dynaviz", command
        code, out, err = run_command(*words)
        assert code == 0, f"{command}\n{err}"
        assert out.strip(), command


def test_commands_are_found() -> None:
    assert sum(map(len, COMMANDS.values())) > 10
    assert any("--failures" in command for command in COMMANDS["tutorial.md"])


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Site:
    """The text of a page of the site, by its path; built once."""
    for package in ("mkdocs", "material", "mkdocstrings", "latex2mathml"):
        pytest.importorskip(package, reason="needs the tools for pages: pip install -e '.[docs]'")
    folder = tmp_path_factory.mktemp("site")
    command = [
        sys.executable,
        "-m",
        "mkdocs",
        "build",
        "--strict",
        "--quiet",
        "--site-dir",
        str(folder),
    ]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert not done.returncode, done.stdout + done.stderr
    return lambda path: (folder / path).read_text(encoding="utf-8")


@pytest.mark.slow
def test_each_method_has_a_page_that_tells_what_its_code_tells(site: Site) -> None:
    for handle in registry.handles("methods"):
        if handle.package == "dynaviz_methods":
            kind, page = (
                handle.load(),
                site(f"methods/{'octomap' if 'octomap' in handle.name else handle.name}.html"),
            )
            names = [
                *kind.Params.__dataclass_fields__,
                *(reason.name for reason in kind.info.reasons),
            ]
            assert names
            assert [name for name in names if f"<code>{name}</code>" not in page] == []
            assert "{{" not in page


@pytest.mark.slow
def test_formulas_need_no_script(site: Site) -> None:
    assert "<mfrac>" in site("protocol.html")
    assert "mathjax" not in site("protocol.html").lower()


@pytest.mark.slow
def test_pages_load_nothing_from_elsewhere(site: Site) -> None:
    for page in ("index.html", "tutorial.html", "methods/octomap.html", "reference/python.html"):
        assert re.findall(r'<(?:script|img|iframe)[^>]*src="https?:', site(page)) == []
        assert re.findall(r'<link[^>]*rel="stylesheet"[^>]*href="https?:', site(page)) == []


@pytest.mark.slow
def test_readmes_are_part_of_the_site_with_links_that_lead_somewhere(site: Site) -> None:
    page = site("protocol.html")
    assert 'href="evaluation.html' in page
    assert "../eval/README.md" not in page
    assert "harmonic" in site("evaluation.html")


def test_all_pictures_together_are_small() -> None:
    pictures = [
        path for path in DOCS.rglob("*") if path.suffix in (".png", ".jpg", ".svg", ".webp")
    ]
    assert sum(path.stat().st_size for path in pictures) < 4_000_000
