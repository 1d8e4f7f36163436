"""What the march of a row of blades costs, counted in its program."""

import numpy as np
import pytest
from command_line import run

import jaxshroud as js
from jaxshroud.scene.checks import InputError

IN_X = 'parts.motion=["x"]'


def explained(blades, *more):
    return js.explain(js.load("row_ring12", [f"row.blades={blades}", "drive.engine_order=1", IN_X, *more]).scene)


@pytest.mark.full
def test_numbers_and_operations_grow_as_the_number_of_blades():
    # Exactly: without rotation there are no clusters, and each blade and each interface adds the same.
    told = [explained(n) for n in (3, 4, 5)]
    for name in ("numbers", "operations"):
        first, second = np.diff([getattr(one, name) for one in told])
        assert first == second > 0
    assert [(one.blades, one.interfaces) for one in told] == [(3, 3), (4, 4), (5, 5)]


@pytest.mark.full
def test_a_chain_of_two_costs_about_as_much_as_the_pair():
    # The row looks at its events and its search with further operations; a stage counted once would be 4 times less.
    pair = js.explain(js.load("table1", [IN_X]).scene)
    chain = explained(2, "row.closed=false")
    assert chain.events == pair.events
    assert 1 < chain.operations / pair.operations < 2


@pytest.mark.full
def test_a_static_start_is_no_part_of_a_step():
    pressed = "shroud.gap=-10um"
    assert explained(3, pressed, "initial.start=static") == explained(3, pressed)


def test_the_advice_of_a_row_is_on_all_of_its_interfaces():
    words = ["row.closed=false", "row.blades=3"]
    assert not [text for text in explained(3, *words, "friction.mu=[0, 0.5]").advice if "mu or k_d" in text]
    assert [text for text in explained(3, *words, "friction.mu=0").advice if "mu or k_d" in text]
    with pytest.raises(InputError, match="many single blades"):
        explained(3, 'parts.contact="none"')


@pytest.mark.full
def test_the_command_tells_the_events_of_all_interfaces(capsys):
    run("explain row_chain5 --set parts.motion=[x] --steps-per-period 200")
    lines = capsys.readouterr().out
    assert "5 blades, 4 interfaces" in lines
    assert "at 4 interfaces, 8 in all" in lines
