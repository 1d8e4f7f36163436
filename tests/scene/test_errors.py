"""One hierarchy of checks, whose members are what Python calls such mistakes."""

import pytest

import jaxshroud as js
from jaxshroud.cli import terminal
from jaxshroud.scene import checks
from jaxshroud.scene.config import parse
from jaxshroud.scene.overrides import axis


@pytest.mark.parametrize(
    ("kind", "kinds"),
    [
        (checks.SceneError, (js.InputError, ValueError)),
        (checks.KeyNameError, (js.SceneError, js.InputError, ValueError, KeyError)),
        (checks.NumericalError, (ValueError,)),
        (checks.StepTooLongError, (js.InputError, ValueError)),
        (checks.StoreError, (js.InputError, ValueError)),
        (checks.WriteError, (js.StoreError, OSError)),
        (checks.MachineError, (js.StoreError, OSError)),
        (terminal.InputError, (js.InputError, ValueError)),
    ],
)
def test_every_error_is_one_of_ours_and_one_of_pythons(kind, kinds):
    assert all(issubclass(kind, other) for other in (js.Error, *kinds))


def test_numbers_that_fail_are_not_the_inputs_fault():
    assert not issubclass(checks.NumericalError, checks.InputError)
    assert not issubclass(js.Interrupted, Exception)


def test_an_unknown_key_is_the_same_error_everywhere(table1):
    file = js.load("table1")
    ways = [
        lambda: js.vary(table1, "shroud.gaps", 1.0),
        lambda: js.value_of(table1, "shroud.gaps"),
        lambda: js.sweep(table1, {"shroud.gaps": [1.0, 2.0]}, n_periods=1),
        lambda: js.tune(table1, {"shroud.gaps": (1.0, 2.0)}),
        lambda: js.gradient(table1, ["shroud.gaps"]),
        lambda: js.scenes_from({"shroud.gaps": [1.0]}, table1),
        lambda: axis(file, "shroud.gaps", [1, 2]),
        lambda: parse(file.text(), "a", ["sweep.along=shroud.gaps", "sweep.values=[1,2]"]),
    ]
    for way in ways:
        with pytest.raises(js.KeyNameError, match=r"no number `shroud\.gaps`; did you mean `shroud\.gap`"):
            way()
    with pytest.raises(js.KeyNameError, match=r"^--set: \[shroud\] has no key `gaps`; did you mean `gap`"):
        parse(file.text(), "a", ["shroud.gaps=1"])


def test_a_message_has_no_quotes_around_it():
    assert str(js.KeyNameError("a `b`")) == "a `b`"
