"""Every notebook runs from top to bottom, at reduced size."""

import re
from pathlib import Path

import jax
import nbformat
import pytest
from nbclient import NotebookClient

DRAWS = re.compile(r"^((plot|plot_design|plt)\.\w+|\w+\.plot)\(.*\)\s*\Z", re.MULTILINE)  # as a cell's last line
NOTEBOOKS = sorted((Path(__file__).parent.parent / "notebooks").glob("*.ipynb"))


@pytest.mark.full(but=["quickstart"])
@pytest.mark.parametrize("path", NOTEBOOKS, ids=[p.stem for p in NOTEBOOKS])
@pytest.mark.filterwarnings("ignore")  # the notebook's kernel reports its own errors; its transport warns
def test_notebook_runs(path, monkeypatch):
    monkeypatch.setenv("JAXSHROUD_QUICK", "1")
    if cache := jax.config.jax_compilation_cache_dir:  # what the command line's tests have compiled
        monkeypatch.setenv("JAX_COMPILATION_CACHE_DIR", cache)
    client = NotebookClient(
        nbformat.read(path, as_version=4), timeout=600, resources={"metadata": {"path": path.parent}}
    )
    answered(client.execute())


@pytest.mark.parametrize("path", NOTEBOOKS, ids=[p.stem for p in NOTEBOOKS])
def test_notebook_is_kept_with_its_outputs(path):
    notebook = nbformat.read(path, as_version=4)
    answered(notebook)
    assert "**The question.**" in notebook.cells[0].source
    assert not [out for cell in notebook.cells for out in cell.get("outputs", []) if out.output_type == "error"]


def answered(notebook):
    """Every picture is there, and the last cell tells the answer."""
    pictures = [cell for cell in notebook.cells if DRAWS.search(cell.source)]
    assert pictures
    for cell in pictures:
        assert [out for out in cell.outputs if "image/png" in out.get("data", {})], cell.source
    told = [out.data["text/markdown"] for out in notebook.cells[-1].outputs if "data" in out]
    assert "**The answer" in told[-1]
