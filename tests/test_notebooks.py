"""Every notebook runs from top to bottom, at reduced size."""

import re
from pathlib import Path

import jax
import nbformat
import pytest
from nbclient import NotebookClient

DRAWS = re.compile(r"^((plot|plt)\.\w+|\w+\.plot)\(.*\)\s*\Z", re.MULTILINE)  # as a cell's last line
NOTEBOOKS = sorted((Path(__file__).parent.parent / "notebooks").glob("*.ipynb"))


@pytest.mark.full
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


def kept(name):
    """What the cells of a notebook are, and all that they have told in words, as it is kept."""
    cells = nbformat.read(Path(__file__).parent.parent / "notebooks" / f"{name}.ipynb", as_version=4).cells
    outputs = [out for cell in cells for out in cell.get("outputs", [])]
    words = [out.get("text", "") or out.get("data", {}).get("text/markdown", "") for out in outputs]
    return "\n".join(cell.source for cell in cells), "\n".join(words)


def test_every_tangent_announced_is_drawn_or_told_to_be_none():
    source, told = kept("gap_tuning")
    assert "the tangents at six gaps" in source
    missing = re.findall(r"gap \d\.\d+ mm: no tangent, the motion is \w+", told)
    drawn = int(re.search(r"tangents drawn: (\d) of 6", told)[1])
    assert drawn + len(missing) == 6
    assert drawn < 6  # control: without their words three would be missing


def test_the_reading_study_says_where_power_is_positive_as_the_page_of_limits_does():
    _, told = kept("reading_study")
    limits = (Path(__file__).parent.parent / "docs" / "limits.md").read_text("utf-8")
    said = r"positive\s+at\s+every\s+point\s+of\s+Figs\.\s+16\s+and\s+18\s+in\s+(\d+)\s+%"
    assert re.search(said, told)[1] == re.search(said, limits)[1]


def test_what_leaves_the_frame_is_told():
    source, told = kept("energy_and_misprints")
    frames = [tuple(map(int, ends)) for ends in re.findall(r"\((-\d+), (\d+)\)", source)]
    ranges = re.findall(r"P_d from +(-?\d+) to +(-?\d+) %(.*)", told)
    assert len(frames) == 2
    assert len(ranges) == 16  # readings of both scenes
    for i, (least, most, words) in enumerate(ranges):
        low, high = frames[i // 8]
        assert ("leaves" in words) == (int(least) < low or int(most) > high)


def test_settings_of_named_accuracies_differ_in_words_and_costs_are_least_ones():
    _, told = kept("speed_and_accuracy")
    settings = re.findall(r"^(?:fast|balanced|reference) +(.* steps):", told, re.MULTILINE)
    assert len(settings) == len(set(settings)) == 3
    costs = re.findall(r"steps: +([\d.]+) us of a core \(least of (\d+), largest ([\d.]+)\)", told)
    assert len(costs) == 18
    assert all(int(times) >= 5 and float(least) <= float(largest) for least, times, largest in costs)
