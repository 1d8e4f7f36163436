"""Float64, strict promotion and run-time type checks for every test."""

import jax
import pytest
from jaxtyping import install_import_hook

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_numpy_dtype_promotion", "strict")

with install_import_hook("jaxshroud", "beartype.beartype"):
    import jaxshroud  # noqa: F401
    from jaxshroud.scene.config import load


def pytest_addoption(parser):
    parser.addoption("--benchmark", action="store_true", help="run the side-by-side timings too")
    parser.addoption("--studies", action="store_true", help="run seeded samples of the studies too")


def pytest_collection_modifyitems(config, items):
    for mark, reason in {"benchmark": "timings run only with --benchmark", "studies": "run with --studies"}.items():
        if not config.getoption(f"--{mark}"):
            for item in items:
                if item.get_closest_marker(mark):
                    item.add_marker(pytest.mark.skip(reason=reason))


@pytest.fixture(scope="session")
def table1():
    """Table 1 of the article with Table 2's gap and F_0, gamma = 2.5, consistent reading."""
    return load("table1", ["contact.gamma=2.5", "drive.F_0=60"]).scene
