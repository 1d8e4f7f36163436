"""Programs of commands stay on disk: a sample of the study, and all before a release."""

import json

import kept_commands
import pytest

pytestmark = pytest.mark.studies
SAMPLE = ("simulate pair", "sweep row")
ALL = [case.name for case in kept_commands.cases()]


@pytest.mark.release(only=[name for name in ALL if name not in SAMPLE])
@pytest.mark.parametrize("name", ALL)
def test_a_second_start_compiles_nothing(name):
    then = json.loads(kept_commands.FILE.read_text("utf-8"))["commands"][name]
    now = kept_commands.found([name])[name]
    assert now["not kept"] == []
    assert now["compiled again"] == 0
    assert now["lowered again"] <= then["lowered again"]


def test_a_program_that_is_not_kept_is_seen(monkeypatch):
    # Control: a static value that cannot be described, as a march that held a choice would have.
    spoilt = kept_commands.CHILD.replace(
        "status = ",
        "from jaxshroud.march import method\nmethod.Choices.__module__ = 'elsewhere'\nstatus = ",
    )
    monkeypatch.setattr(kept_commands, "CHILD", spoilt)
    then = json.loads(kept_commands.FILE.read_text("utf-8"))["commands"]["simulate pair"]
    now = kept_commands.found(["simulate pair"])["simulate pair"]
    assert now["not kept"]
    assert now["lowered again"] > then["lowered again"]
