"""One name, one thing: no name but private ones is defined at the top of two modules of the package."""

import ast
import re
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

import jaxshroud

ROOT = Path(jaxshroud.__file__).parent


def names_of(source: str) -> Iterator[str]:
    """The names that a module defines at its top, without those that it imports."""
    for node in ast.parse(source).body:
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            yield node.name
        targets = node.targets if isinstance(node, ast.Assign) else [getattr(node, "target", None)]
        for target in targets:
            parts = target.elts if isinstance(target, ast.Tuple) else [target]
            yield from (part.id for part in parts if isinstance(part, ast.Name))


def test_the_scan_sees_every_kind_of_definition():
    source = "import a\nB: int = 1\nC, D = 2, 3\ndef e(): f = 1\nclass G: h = 1\n"
    assert list(names_of(source)) == ["B", "C", "D", "e", "G"]


def test_a_name_is_defined_once():
    places = defaultdict(set)
    for path in ROOT.rglob("*.py"):
        for name in names_of(path.read_text("utf-8")):
            if not name.startswith("_"):
                places[name].add(str(path.relative_to(ROOT)))
    assert not {name: sorted(at) for name, at in places.items() if len(at) > 1}


NAMED = re.compile(r"\bjs\.([A-Za-z]\w*)|\b([A-Z][a-z]\w*)\(")  # js.name, and Name( as a call
NOT_OF_PYTHON = {"String", "Number"}  # of the page's JavaScript


def messages_of(tree: ast.Module) -> Iterator[str]:
    """The texts of a module that are no docstrings."""
    docs = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    texts = (n for n in ast.walk(tree) if isinstance(n, ast.Constant) and id(n) not in docs)
    yield from (n.value for n in texts if isinstance(n.value, str))


def test_messages_name_nothing_that_does_not_exist():
    missing = {
        (str(path.relative_to(ROOT)), name)
        for path in ROOT.rglob("*.py")
        for text in messages_of(ast.parse(path.read_text("utf-8")))
        for names in NAMED.findall(text)
        for name in names
        if name and name not in NOT_OF_PYTHON and not hasattr(jaxshroud, name)
    }
    assert not missing
