"""Which module may import which: the data flows one way, and physics knows nothing of files and pictures."""

import ast
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

import jaxshroud

ROOT = Path(jaxshroud.__file__).parent
# A module imports from its own folder and from those before it.
FOLDERS = ["", "cache", "scene", "model", "march", "linear", "batch", "signals", "orbits", "fitting", "io"]
FOLDERS += ["plotting", "results", "verbs", "explorer", "cli"]
EDGES = ("io", "plotting", "results", "explorer", "cli", "scene")
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


@cache
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


@cache
def uses() -> dict[str, set[str]]:
    """The modules of the package that each of them imports."""
    return {name: {within(used) for used in imported(path)} - {None} for name, path in MODULES.items()}


def folder(module: str) -> str:
    """The folder of a module; a folder is in itself."""
    return module.partition(".")[0] if module.partition(".")[0] in FOLDERS else ""


def test_every_folder_has_its_place():
    assert {path.parent.name for path in ROOT.rglob("*.py")} == {*FOLDERS[1:], ROOT.name}


@pytest.mark.parametrize("module", INNER)
def test_a_module_imports_only_from_its_folder_and_those_before(module):
    above = FOLDERS[: FOLDERS.index(folder(module)) + 1]
    wrong = {used for used in uses()[module] if folder(used) not in above}
    assert not wrong, f"{module} imports {sorted(wrong)}"


def test_no_module_imports_itself_by_way_of_others():
    tuple(TopologicalSorter(uses()).static_order())  # raises CycleError


def test_the_scan_sees_imports():
    # Control: a command imports physics at the top, and a type of arguments inside a function.
    assert "scene.schema" in uses()["scene.config"]
    assert "verbs.sweep" in uses()["cli.sweep"]
    assert "verbs.accuracy" in uses()["cli.option_table"]


@pytest.mark.parametrize("module", [module for module in INNER if folder(module) not in EDGES])
def test_physics_knows_no_files_and_no_pictures(module):
    assert not {name.split(".")[0] for name in imported(MODULES[module])} & FOR_EDGES_ONLY


@pytest.mark.parametrize("module", ["", *FOLDERS[1:]])
def test_a_package_only_re_exports(module):
    body = ast.parse(MODULES[module].read_text()).body
    assert isinstance(body[0], ast.Expr)  # its docstring
    assert all(isinstance(node, ast.Import | ast.ImportFrom | ast.Assign) for node in body[1:])
