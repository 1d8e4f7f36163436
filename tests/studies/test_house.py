"""The counter of forks and of code, on small sources whose counts are known."""

import ast

import house
import pytest
from house_forks import modules_of

pytestmark = pytest.mark.studies

TESTS = {
    "if": "if {}: pass",
    "elif": "if x: pass\nelif {}: pass",
    "while": "while {}: pass",
    "assert": "assert {}",
    "ternary": "a = x if {} else y",
    "filter": "a = [b for b in c if {}]",
    "operand": "a = b and ({})",
    "guard": "match x:\n    case 1 if {}: pass",
    "where": "a = np.where({}, x, y)",
    "index": "a = TABLE[{}]",
    "get": "a = {{True: x, False: y}}.get({})",
    "arithmetic": "a = 7 + ({})",
}
ROWS = [
    "scene.row is None",
    "lanes.scene.row_size is not None",
    "not (scene.row is None)",
    "row.closed",
    "self.closed",
    "blades == 2",
    "scene.n_blades > 2",
    "2 < len(blades)",
    "blade_count(size) == 2",
    "scene.shroud.gap.ndim == 1",
    "np.ndim(state.u_s) > 0",
    "isinstance(run, RowTrajectory)",
    "isinstance(run, A | RowRun)",
    "issubclass(kind, results.RowOrbit)",
    "type(run) is RowTrajectory",
    "isinstance(state.motion.x, tuple)",
    'scene.layout == "row"',
    'data.attrs["kind"] == "row"',
    '"row" in tables',
    'hasattr(scene, "row")',
    "any(scene.row is None for scene in scenes)",
    "bool(scene.in_row)",
]
# Whole sources with the number of their forks.
SOURCES = {
    "truth of a row": ("if scene.row: pass", 1),
    "one test that names three": ("if scene.row is None or row.closed and blades == 2: pass", 1),
    "one within another": ("a = x if scene.row is None else y if scene.row.closed else z", 2),
    "match of a row": ("match scene.row:\n    case None: pass\n    case RowSize(): pass", 1),
    "match of classes": ("match run:\n    case RowTrajectory(): pass\n    case Trajectory(): pass", 1),
    "mapping by layout": ("a = MARCHES[scene.layout]", 1),
    "mapping by blades": ("a = MARCHES[n_blades]", 1),
    "mapping by class": ("T = {Trajectory: f, RowTrajectory: g}\na = T[type(run)](run)", 1),
    "registered class": ("@told.register(RowTrajectory)\ndef _(run): pass", 1),
    "registered annotation": ("@told.register\ndef _(run: RowTrajectory): pass", 1),
    "rank as an end": ('a = ("point", "interface")[: gap.ndim]', 1),
    "row of a table": ('def f(tables):\n    row = tables.get("row")\n    return 1 if row is None else 2', 1),
    "annotated parameter": ("def f(size: RowSize | None):\n    if size is None: pass", 1),
    "parameter by its name": ("def f(whole_row):\n    return a if whole_row else b", 1),
    "other name": ("def f():\n    pair = scene.row is None\n    if pair: pass\n    return x if pair else y", 2),
    "other name of a class": ("is_row = isinstance(a, RowRun)\nif is_row: pass\nassert not is_row", 2),
    "name in a tuple": ("def f():\n    a, b = 1, scene.row is None\n    return a if b else 0", 1),
    "name of a name": ("def f():\n    a = scene.row is None\n    b = not a\n    if b: pass", 1),
    "empty for a pair": ("def f():\n    a = [] if scene.row is None else [1]\n    if a: pass", 2),
    "chosen function": ("def f():\n    a = g if scene.row is None else h\n    if a is g: pass", 2),
    "attribute": ("class A:\n    def f(self):\n        self.many = scene.row is None\n        if self.many: pass", 1),
    "property": ("class A:\n    @property\n    def many(self): return self.scene.row is None\nif a.many: pass", 1),
    "function": ("def many(scene): return scene.row is not None\nif many(scene): pass", 1),
    "parameter that is given it": ("def f(many):\n    if many: pass\nf(scene.row is None)\nf(many=False)", 1),
    "motion": ("a = [f(b) if isinstance(b, tuple) else b for b in state.motion]", 1),
}
NO_FORKS = {
    "row of a table": "for row in rows:\n    if row == 3: pass\n    if row: pass",
    "filter of rows": "a = [row for row in rows if row]",
    "key": "def f(key):\n    row = KEYS.get(key)\n    return None if row is None else row.default",
    "other parameter": "def f(row: Key):\n    if row is None: pass",
    "None": "if name is None: pass",
    "attribute of a row": "if row.name in NAMES or row.unit: pass",
    "closed server": "class A:\n    def f(self):\n        self.closed = True\n        if self.closed: pass",
    "closed form": 'closed = scene.parts.contact == "none"\nif closed: pass',
    "number in its range": "if not FEWEST <= blades <= MOST: pass",
    "type of a number": "if isinstance(blades, int): pass",
    "other rank": "if column.ndim != 1: pass",
    "classes of both": "if isinstance(accuracy, Choice | RowChoice): pass",
    "other tuple": "if isinstance(value, tuple): pass",
    "definition": "in_row = scene.row is not None",
    "passed on": "f(scene.row is not None)",
    "index that is called row": "a = moments[:, amplitude.row]",
    "parameter that is given else": "def f(many):\n    if many: pass\nf(scene.row is None)\nf(x > 3)",
    "word": 'if (table, name) == ("row", "mistuning"): pass',
}


def forks(source: str) -> int:
    """The number of forks of a source."""
    return len(modules_of({"one.py": source})["one.py"].forks)


@pytest.mark.parametrize("row", ROWS)
@pytest.mark.parametrize("test", TESTS)
def test_a_test_on_row_or_pair_is_a_fork(test, row):
    assert forks(TESTS[test].format(row)) == 1


@pytest.mark.parametrize("name", SOURCES)
def test_forks_are_counted_once_each(name):
    source, count = SOURCES[name]
    assert forks(source) == count


@pytest.mark.parametrize("name", NO_FORKS)
def test_what_is_no_fork_is_not_counted(name):
    assert forks(NO_FORKS[name]) == 0


def test_a_function_of_another_module_is_known():
    sources = {"a.py": "def many(scene): return scene.row is not None", "b.py": "if many(scene): pass"}
    assert len(modules_of(sources)["b.py"].forks) == 1


def test_forks_that_are_passed_on_are_told():
    assert modules_of({"a.py": "f(scene.row is None)\ng(x)\nif bool(scene.in_row): pass"})["a.py"].passed == 1


def test_code_is_counted_without_comments_and_docstrings():
    source = '"""About\nit."""\n\n# a remark\na = (\n    1,  # one\n)\n\n\ndef f():\n    """Nothing."""\n    return a\n'
    assert house.code_lines(source, ast.parse(source)) == 5
    assert len(house.tokens_of(source)) == 15


def test_totals_of_small_modules():
    sources = {
        "jaxshroud/__init__.py": "",
        "jaxshroud/a.py": "from jaxshroud import b\nfrom jaxshroud.c import (\n    d,\n)\nx, y = 1, 2\nx, y = y\n",
        "jaxshroud/b.py": "def f():\n    import jaxshroud.c\n    g = lambda: 1\n    return g(lambda: 2)\n",
        "jaxshroud/c.py": "class RowRun: pass\nclass Rows: pass\ndef f(in_row, a: RowSize | None): pass\n",
    }
    totals = house.code_totals(sources)
    assert totals["modules"] == totals["small modules"] == 3
    assert totals["modules with one importer"] == 1
    assert (totals["import lines"], totals["imports inside functions"]) == (5, 1)
    assert (totals["packed tuples"], totals["bound lambdas"]) == (1, 1)
    assert (totals["classes of rows"], totals["lines with in_row"], totals["sizes or None"]) == (1, 1, 1)


def test_kernels_and_public_names():
    assert house.is_kernel("jaxshroud/march/row_trial.py")
    assert not house.is_kernel("jaxshroud/results/row.py")
    assert house.public_names(["from a import b as b, c\n", '__all__ = ["d"]\n']) == {"b", "d"}
