"""The code does not grow beyond its budget; see tests/studies/house_budget.py."""

import json
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent / "studies"))
house_budget = pytest.importorskip("house_budget")


def test_the_code_keeps_its_budget():
    budget = json.loads(house_budget.FILE.read_text("utf-8"))
    assert not house_budget.overdrawn(house_budget.counts(), budget), "see tests/studies/house_budget.py"
    assert all(feature["name"] and feature["reason"] for feature in budget["features"])


def test_what_is_worth_its_tokens_is_not_counted():
    bare = house_budget.counted_tokens("def f(a, b=1): return g(a, b)\n")
    noted = "def f(a: dict[str, int], b: float = 1) -> float: return g(first=a, second=b)\n"
    # The colons and the arrow remain.
    assert house_budget.counted_tokens(noted) == bare + 3
    assert house_budget.counted_tokens("# a remark\nx = 1\n\n") == 3


def test_unlike_assignments_are_found():
    found = {
        "a, b = x, y": False,
        "a, b = 1, -2.0": False,
        "a, b = f(x), f(y)": False,
        "a, b = f(x), g(y)": True,
        "a, b = x, 1": True,
        "a, b = pair": False,
        "a = x": False,
    }
    for text, unlike in found.items():
        assert any(map(house_budget.is_unlike, house_budget.ast.walk(house_budget.ast.parse(text)))) is unlike, text


def test_records_that_splats_fill_are_found():
    record = "class Pair(NamedTuple):\n    a: int\n    b: int\n"
    for call, splats in {"Pair(*x)": 1, "Pair(1, *x)": 1, "Pair(1, b=2)": 0, "Pair._make(x)": 0, "f(*x)": 0}.items():
        assert house_budget.splats_into_records([house_budget.ast.parse(record + call)]) == splats, call


def test_what_is_overdrawn_is_told():
    budget = {"most": {"modules": 3}, "least": {"annotated arguments": 900}, "features": []}
    assert house_budget.overdrawn({"modules": 3, "annotated arguments": 900}, budget) == []
    assert house_budget.overdrawn({"modules": 4, "annotated arguments": 899}, budget) == [
        "modules: 4, at most 3",
        "annotated arguments: 899, at least 900",
    ]
    budget["features"] = [{"name": "wheels", "reason": "asked for", "adds": {"modules": 1}}]
    assert house_budget.overdrawn({"modules": 4, "annotated arguments": 900}, budget) == []
    assert house_budget.overdrawn({"new room": 1, "annotated arguments": 900}, budget) == ["new room: 1, at most 0"]
