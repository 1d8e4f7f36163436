"""docs/contract.md lists what there is: public names, variables of results, files of commands, numbers of statuses.

`python tests/test_contract.py` prints the lists of variables and of files as the page has them.
"""

import importlib
import pkgutil
import re
from collections.abc import Iterable
from pathlib import Path

import jaxshroud as js
from jaxshroud.cli.command_table import COMMANDS
from jaxshroud.io.variable import Variable
from jaxshroud.results.base import Result

PAGE = Path(__file__).parent.parent / "docs" / "contract.md"
EVERY = "every result"


def variables() -> dict[str, list[str]]:
    """The names of variables in files, by the classes of results that have them."""
    for module in pkgutil.iter_modules(importlib.import_module("jaxshroud.results").__path__):
        importlib.import_module(f"jaxshroud.results.{module.name}")
    users: dict[type, list[str]] = {}
    for _, kind in sorted(Result.classes.items()):
        for base in kind.__mro__:
            users.setdefault(base, []).append(kind.__name__)
    listed: dict[str, list[str]] = {EVERY: []}
    for base, kinds in users.items():
        names = [v.name for v in vars(base).values() if isinstance(v, Variable) and v.name[0] != "_"]
        listed.setdefault(EVERY if base is Result else marked(sorted(kinds)), []).extend(names)
    return {who: names for who, names in listed.items() if names}


def marked(names: Iterable[str]) -> str:
    """Names as a page has them."""
    return ", ".join(f"`{name}`" for name in names)


def lines() -> list[str]:
    """The lists of the page."""
    files = {marked([name]): command.files for name, command in COMMANDS.items() if command.files}
    return [f"- {who}: {marked(names)}" for who, names in (*variables().items(), *files.items())]


def test_the_contract_lists_the_public_names():
    listed = PAGE.read_text("utf-8").split("\n## Python\n")[1].split("An argument that")[0]
    assert sorted(re.findall(r"`([A-Za-z_]\w*)`", listed.partition(":\n\n")[2])) == sorted(js.__all__)


def test_the_contract_lists_variables_and_files():
    kept = PAGE.read_text("utf-8").splitlines()
    assert [line for line in lines() if line not in kept] == []
    assert any(line.startswith("- `SweepResult`: ") and "`period_number`" in line for line in lines())


def test_the_contract_lists_how_runs_end():
    page = PAGE.read_text("utf-8")
    for kind in (js.Status, js.Mode):
        assert ", ".join(f"{number.value} {number.name}" for number in sorted(kind)) in page


if __name__ == "__main__":
    print("\n".join(lines()))
