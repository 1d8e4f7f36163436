"""Which module may import which: the data flows one way, and physics knows nothing of files and pictures."""

import ast
from pathlib import Path

import pytest

import jaxshroud

ROOT = Path(jaxshroud.__file__).parent
# Every module imports from those above it only.
ORDER = [
    "version",
    "checks",
    "extent",
    "absent",
    "scene",
    "state",
    "trig",
    "geometry",
    "linear",
    "contact",
    "friction",
    "compiled",
    "lanes",
    "threads",
    "rhs",
    "events",
    "tableau",
    "locate",
    "within",
    "implicit",
    "integrate",
    "stability",
    "periods",
    "chatter",
    "free",
    "analysis",
    "analysis.interval",
    "analysis.settling",
    "analysis.period",
    "analysis.power",
    "analysis.spectrum",
    "sweep",
    "power",
    "trajectory",
    "explain",
    "tangents",
    "periodmap",
    "orbit",
    "gradient",
    "lyapunov",
    "tune",
    "setting",
    "adaptive",
    "trade",
    "accuracy",
    # the edges
    "schema",
    "config",
    "files",
    "store",
    "earlier",
    "drawing",
    "plot",
    "plot_design",
    "keyboard",
    "terminal",
    "cli_design",
    "cli_plot",
    "cli_trade",
    "cli",
]
EDGES = ORDER[ORDER.index("schema") :]
FOR_EDGES_ONLY = {
    "pydantic",
    "pint",
    "rich",
    "matplotlib",
    "xarray",
    "h5netcdf",
    "h5py",
    "tomllib",
    "tomli_w",
    "argparse",
}


def modules() -> dict[str, Path]:
    """Every module of the package by its name, the package itself as ''."""
    paths = {path.relative_to(ROOT).with_suffix(""): path for path in sorted(ROOT.rglob("*.py"))}
    return {".".join(part for part in name.parts if part != "__init__"): path for name, path in paths.items()}


def imported(path: Path) -> set[str]:
    """Full names of all that a file imports, inside functions too."""
    names = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path.name} has a relative import"
            names |= {f"{node.module}.{alias.name}" for alias in node.names}
    return names


def within(name: str) -> str | None:
    """The module of the package that an imported name belongs to; None if it is another package's."""
    if name.split(".")[0] != "jaxshroud":
        return None
    parts = name.split(".")[1:]
    while parts and ".".join(parts) not in MODULES:
        parts.pop()
    return ".".join(parts)


MODULES = modules()
INNER = sorted(set(MODULES) - {""})
USES = {name: {within(used) for used in imported(path)} - {None} for name, path in MODULES.items()}


def test_the_order_names_every_module_once():
    assert sorted(ORDER) == INNER


@pytest.mark.parametrize("module", INNER)
def test_a_module_imports_only_from_those_above_it(module):
    # An order that holds for all of them is also the proof that there is no cycle.
    above = ORDER[: ORDER.index(module)]
    assert USES[module] <= set(above), f"{module} imports {sorted(USES[module] - set(above))}"


def test_the_scan_sees_imports():
    # Control: an edge imports physics, at the top and inside a function.
    assert {"scene", "schema"} <= USES["config"]
    assert {"trajectory", "sweep"} <= USES["cli"]
    assert "plot" in USES["cli_plot"]


@pytest.mark.parametrize("module", [module for module in INNER if module not in EDGES])
def test_physics_knows_no_files_and_no_pictures(module):
    assert not {name.split(".")[0] for name in imported(MODULES[module])} & FOR_EDGES_ONLY


def test_the_package_itself_only_re_exports():
    body = ast.parse(MODULES[""].read_text()).body
    assert all(isinstance(node, ast.ImportFrom) for node in body[1:])
    assert isinstance(body[0], ast.Expr)  # its docstring
