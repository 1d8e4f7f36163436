"""Examples in docstrings of the verbs are run."""

import doctest
from importlib import import_module

import pytest


@pytest.mark.parametrize("verb", ["simulate", "sweep", "power"])
def test_examples(verb):
    done = doctest.testmod(import_module(f"jaxshroud.verbs.{verb}"))
    assert done.attempted > 0
    assert done.failed == 0
