"""Numbers as texts in the unit that is shown, and what is read of commas: one parser for page, `--set` and files."""

import math
import random

import numpy as np
import pytest

from jaxshroud.scene.config import SceneError, load, parse
from jaxshroud.scene.keys import ALL_KEYS, number_shape
from jaxshroud.scene.layout import PAIR, row_layout
from jaxshroud.scene.text import override_of, read_shown, shown_text

VALUES = 1000  # of each key and shape
SHAPES = PAIR, row_layout(3, False), row_layout(12, True)  # of the pair, of a chain and of a ring


def draw(of: random.Random) -> float:
    """A double: as one types it, of any size, a power of two, or an end of the range of doubles."""
    kinds = (
        lambda: float(f"{of.uniform(-100, 100):.3g}"),
        lambda: of.uniform(-1, 1),
        lambda: of.uniform(-1, 1) * 10.0 ** of.randint(-300, 300),
        lambda: math.ldexp(1.0, of.randint(-1000, 1000)),
        lambda: of.choice([0.0, 5e-324, 1.7976931348623157e308, math.nextafter(1.0, 2.0)]),
    )
    return of.choice(kinds)()


@pytest.mark.full(but=["shroud.gap", "drive.speed"])  # of a decimal factor, and of another
@pytest.mark.parametrize("name", ALL_KEYS)
def test_what_is_shown_of_a_number_reads_as_that_number(name):
    # To the last bit: no digit is lost by the unit that is shown.
    key, of = ALL_KEYS[name], random.Random(name)
    values = [draw(of) for _ in range(VALUES)]
    texts = [shown_text(key, value) for value in values]
    assert [read_shown(key, text) for text in texts] == values
    for (size,) in {number_shape(key, row) for row in SHAPES} - {()}:
        lists = [values[i : i + size] for i in range(0, VALUES, size)]
        assert [read_shown(key, shown_text(key, one)) for one in lists] == lists


@pytest.mark.parametrize(
    ("name", "text", "value"),
    [
        ("drive.beta", "34", math.radians(34)),  # degrees, as they are shown
        ("drive.beta", "[28.6479, 34]", [math.radians(28.6479), math.radians(34)]),
        ("drive.beta", "[30 deg, 34]", [math.radians(30), math.radians(34)]),
        ("drive.beta", "0.5 rad", 0.5),
        ("blades.k_x", "[100, 120 kN/m]", [1e5, 1.2e5]),
        ("shroud.gap", "0.022", 2.2e-5),
        ("shroud.gap", "22 um", 2.2e-5),
        ("drive.speed", "1450", 1450 * math.pi / 30),
        ("friction.mu", "4e-1", 0.4),
    ],
)
def test_a_bare_number_is_in_the_unit_that_is_shown_and_others_in_their_own(name, text, value):
    # math.radians and pi / 30 are rounded once more than the exact conversion.
    np.testing.assert_allclose(read_shown(ALL_KEYS[name], text), value, rtol=3e-16)


COMMAS = [
    ("blades.c_x", "3,57"),
    ("drive.beta", "1,5"),
    ("shroud.gap", "0,022 mm"),
    ("drive.F_0", "1,000.5"),
    ("drive.beta", "10 deg, 0.5"),
    ("blades.k_x", "1e5,1.2e5"),
    ("contact.gamma", "3,"),
]


@pytest.mark.parametrize(("name", "text"), COMMAS)
def test_a_comma_is_refused_with_the_cure_wherever_it_is_written(name, text):
    table, key = name.split(".")
    cure = r"has a comma: the decimal mark is a point, as in 3\.57, and a list has brackets, as in \[3, 57\]"
    with pytest.raises(SceneError, match=rf"--set: \[{table}\] {key} = .*{cure}"):
        load("table1", [f"{name}={text}"])
    scene = load("table1", [f"{name}=1"]).text()
    line = next(line for line in scene.splitlines() if line.startswith(f"{key} = "))
    with pytest.raises(SceneError, match=rf"my\.toml: \[{table}\] {key} = .*{cure}"):
        parse(scene.replace(line, f'{key} = "{text}"'), "my.toml")
    assert override_of(ALL_KEYS[name], text) == text  # of a page, which the schema refuses as well


@pytest.mark.parametrize("text", ["0.4 # no", "0.4 0.5", "0.4]\nx=[1", "[0.4", "0.4 0", "−5", "1 000", "true", ""])
def test_what_is_no_number_is_not_read_in_part(text):
    with pytest.raises(ValueError, match=r"is not a number|has an unknown unit"):
        read_shown(ALL_KEYS["friction.mu"], text)
    with pytest.raises(SceneError):
        load("table1", [f"friction.mu={text}"])


def test_lists_of_words_need_no_brackets():
    by_words, by_list = (load("table1", [f"parts.motion={text}"]) for text in ("x,y", '["x", "y"]'))
    assert by_words.tables == by_list.tables == load("table1", ["parts.motion=[x, y]"]).tables
