"""Examples in docstrings are run."""

import doctest
from importlib import import_module

import pytest

VERBS = (
    "simulate",
    "sweep",
    "power",
    "orbit",
    "gradient",
    "lyapunov",
    "tune",
    "explain",
    "branch",
    "attractors",
    "basins",
    "trade",
    "check",
    "diagnose",
)


OTHERS = ("march.method", "scene.grids", "scene.scene", "batch.rollout", "batch.sweepfunction", "model.lawcheck")


@pytest.mark.parametrize("module", [*(f"verbs.{verb}" for verb in VERBS), *OTHERS])
def test_examples(module):
    done = doctest.testmod(import_module(f"jaxshroud.{module}"))
    assert done.attempted > 0
    assert done.failed == 0
