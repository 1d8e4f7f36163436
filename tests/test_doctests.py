"""Examples in docstrings are run."""

import doctest
import pkgutil
from importlib import import_module
from pathlib import Path

import pytest

import jaxshroud

LONG = {  # seconds each; pages of the documentation show the same
    *("jaxshroud.batch.rollout", "jaxshroud.batch.sweepfunction"),
    *(f"jaxshroud.verbs.{verb}" for verb in ("attractors", "branch", "diagnose", "fit", "options", "report")),
    *(f"jaxshroud.verbs.{verb}" for verb in ("gradient", "mistune", "response", "trade", "tune")),
}


def with_examples():
    """Names of the modules whose docstrings have examples."""
    found = (module.name for module in pkgutil.walk_packages(jaxshroud.__path__, "jaxshroud."))
    names = ["jaxshroud", *(name for name in found if not name.endswith("__main__"))]
    finder = doctest.DocTestFinder()
    return [name for name in names if any(one.examples for one in finder.find(import_module(name)))]


MODULES = with_examples()


def test_no_example_is_passed_over():
    root = Path(jaxshroud.__file__).parent
    paths = [path.relative_to(root.parent).with_suffix("") for path in root.rglob("*.py") if ">>> " in path.read_text()]
    assert {".".join(path.parts).removesuffix(".__init__") for path in paths} == set(MODULES)


@pytest.mark.release(only=["jaxshroud.verbs.fit", "jaxshroud.verbs.report", "jaxshroud.verbs.trade"])
@pytest.mark.parametrize(
    "module", [pytest.param(name, marks=pytest.mark.full) if name in LONG else name for name in MODULES]
)
def test_examples(module):
    done = doctest.testmod(import_module(module))
    assert done.attempted > 0
    assert done.failed == 0
