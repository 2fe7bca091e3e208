"""The notebook of the pages runs from top to bottom, and shows the recording."""

from __future__ import annotations

from pathlib import Path

import pytest

NOTEBOOK = Path(__file__).resolve().parents[2] / "docs/notebooks/first_run.ipynb"


@pytest.mark.filterwarnings("ignore::DeprecationWarning")  # of Jupyter's own
@pytest.mark.slow
def test_it_runs_and_shows_a_picture(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    nbformat = pytest.importorskip(
        "nbformat", reason="needs Jupyter's client: pip install -e '.[dev]'"
    )
    nbclient = pytest.importorskip(
        "nbclient", reason="needs Jupyter's client: pip install -e '.[dev]'"
    )
    pytest.importorskip("ipykernel", reason="needs a kernel for notebooks: pip install -e '.[dev]'")
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    notebook = nbformat.read(NOTEBOOK, 4)
    assert not any(cell.get("outputs") for cell in notebook.cells), (
        "keep the notebook without outputs"
    )
    try:
        nbclient.NotebookClient(notebook, timeout=240, kernel_name="python3").execute()
    except nbclient.exceptions.CellExecutionError as error:
        if "mesa-vulkan-drivers" in str(error):
            pytest.skip("nothing to draw with here")
        raise
    texts = "".join(
        output.get("text", "") for cell in notebook.cells for output in cell.get("outputs", ())
    )
    kinds = {
        kind
        for cell in notebook.cells
        for output in cell.get("outputs", ())
        for kind in output.get("data", {})
    }
    assert "4 frames" in texts
    assert "%  frame" in texts
    assert kinds & {"image/png", "application/vnd.jupyter.widget-view+json"}
