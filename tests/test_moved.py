"""Names of version 0.1.0 are found where its modules were, with a warning."""

import importlib
import json
import warnings
from pathlib import Path

import pytest

# Of every module: what it defined that was not private.
NAMES = json.loads((Path(__file__).parent / "names.json").read_text("utf-8"))


@pytest.mark.parametrize("module", NAMES)
def test_every_name_is_still_there(module):
    with warnings.catch_warnings(action="ignore", category=DeprecationWarning):
        old = importlib.import_module(f"jaxshroud.{module}")
        missing = [name for name in NAMES[module] if not hasattr(old, name)]
    assert not missing


def test_an_old_path_says_where_to_look():
    with pytest.warns(
        DeprecationWarning, match=r"jaxshroud\.integrate is deprecated: march is in jaxshroud\.batch\.loop"
    ):
        from jaxshroud.integrate import march  # noqa: F401
    with pytest.raises(ImportError):
        from jaxshroud.integrate import no_such_name  # noqa: F401


def test_an_old_path_does_not_hide_the_function_of_its_name():
    import jaxshroud.sweep

    assert callable(jaxshroud.sweep)
    assert jaxshroud.sweep is jaxshroud.verbs.sweep.sweep
