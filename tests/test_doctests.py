"""Examples in docstrings are run."""

import doctest
from importlib import import_module
from pathlib import Path

import pytest

import jaxshroud

LONG = {  # seconds each; pages of the documentation show the same
    "jaxshroud.batch.rollout",
    *(f"jaxshroud.verbs.{verb}" for verb in ("attractors", "branch", "diagnose", "fit", "report")),
    *(f"jaxshroud.verbs.{verb}" for verb in ("gradient", "mistune", "response", "trade", "tune")),
}
PACKAGE = Path(jaxshroud.__file__).parent
PATHS = [path.relative_to(PACKAGE.parent) for path in sorted(PACKAGE.rglob("*.py")) if ">>> " in path.read_text()]
MODULES = [".".join(path.with_suffix("").parts).removesuffix(".__init__") for path in PATHS]


@pytest.mark.release(only=["jaxshroud.verbs.fit", "jaxshroud.verbs.report", "jaxshroud.verbs.trade"])
@pytest.mark.parametrize(
    "module", [pytest.param(name, marks=pytest.mark.full) if name in LONG else name for name in MODULES]
)
def test_examples(module):
    done = doctest.testmod(import_module(module))
    assert done.attempted > 0
    assert done.failed == 0
