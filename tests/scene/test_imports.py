"""What is imported, in a fresh interpreter: files are read without JAX, and scenes are listed without anything."""

import subprocess
import sys

import pytest

from jaxshroud.scene.config import load

HEAVY = ("jax", "equinox", "matplotlib", "pandas", "xarray", "h5netcdf", "scipy", "numpy", "pydantic", "pint", "rich")
READ = {"numpy", "pydantic"}  # what a file of plain numbers takes
PLAIN = "from jaxshroud.scene.config import axis, load, parse\n"


def imported(program: str) -> set[str]:
    """Which of the heavy packages a program imports."""
    program += f"\nimport sys\nprint(*(name for name in {HEAVY} if name in sys.modules))"
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    return set(run.stdout.splitlines()[-1].split()) if run.stdout.strip() else set()


@pytest.mark.parametrize(
    ("program", "most"),
    [
        ("import jaxshroud", set()),
        ("import jaxshroud\njaxshroud.shipped()", set()),
        ("from jaxshroud.scene.shipped import shipped\nshipped()", set()),
        ("import jaxshroud.scene.keys, jaxshroud.scene.checks, jaxshroud.scene.layout, jaxshroud.scene.checks", set()),
        (PLAIN, READ),
        (PLAIN + "text = load('table1').text()\nassert '[shroud]' in text", READ),
        (PLAIN + "axis(load('table1'), 'shroud.gap', ['1 um', '2 mm'])", READ),
    ],
)
def test_reading_imports_no_more_than_it_needs(program, most):
    assert imported(program) <= most


def test_a_stored_scene_is_read_without_units():
    text = load("fig09", ["parts.contact=smooth", "contact.width=1 um"]).text()
    program = PLAIN + f"file = parse({text!r}, 'stored')\nassert file.axes and file.sweep_run and file.text()"
    assert imported(program) == READ


@pytest.mark.release
@pytest.mark.full
def test_a_scene_is_built_when_it_is_asked_for():
    # Control: the scan sees JAX.
    assert {"jax", "pint"} <= imported(PLAIN + "load('table1', ['shroud.gap=1e-3 inch']).scene")
