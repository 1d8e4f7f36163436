"""Examples in docstrings are run."""

import doctest
from importlib import import_module

import pytest

VERBS = ("simulate", "sweep", "power", "orbit", "gradient", "lyapunov", "tune", "explain", "trade", "check")


@pytest.mark.parametrize("module", [*(f"verbs.{verb}" for verb in VERBS), "march.method", "scene.grids"])
def test_examples(module):
    done = doctest.testmod(import_module(f"jaxshroud.{module}"))
    assert done.attempted > 0
    assert done.failed == 0
