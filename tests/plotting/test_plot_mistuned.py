"""The picture of a mistuned row: what it shows, and where Whitehead's factor is."""

import numpy as np
import pytest
from test_plot import drawing, entries

from jaxshroud.plotting.pictures import BEHIND, picture
from jaxshroud.plotting.style import GREY
from jaxshroud.results.mistuned import Mistuned, mistuned_coordinates

N, VALUES = 12, np.linspace(1000.0, 1400.0, 21)


def mistuned(spread, *, patterns=40, designs=("none", "alternate:0.02"), sigmas=(0.01, 0.03), searched=False):
    """A ring of 12 whose amplifications lie between 1 and 1 + `spread`, at two sigmas."""
    random, shape = np.random.default_rng(0), (len(designs), 2, patterns)
    level = 1 + spread * random.uniform(size=shape)
    curve = 1e-4 / np.hypot(1, (VALUES - 1200) / 40)
    quantile = np.moveaxis(np.quantile(level, (0.05, 0.5, 0.95), axis=-1), 0, -1)
    ends = {"quantile_low": quantile - 0.02 * spread, "quantile_high": quantile + 0.02 * spread}
    ends["quantile_high"][..., -1] = np.nan
    values = {
        "mistuning": 0.03 * random.standard_normal((*shape, N)),
        "amplitude": level[..., None, None] * curve,
        "amplification": level,
        "status": np.zeros((*shape, 1, len(VALUES))),
        "quantile": quantile,
        **ends,
        "tuned_amplitude": curve[None],
        "of": "x_peak",
    }
    if searched:
        values |= {"searched_mistuning": values["mistuning"][0, 0, 0], "searched_amplitude": 2 * curve[None]}
    coords = mistuned_coordinates("drive.omega", VALUES, designs, np.array(sigmas), ("independent",), N)
    return Mistuned.from_values(values, coords=coords, attrs={"title": ""}).data


@pytest.mark.parametrize(("spread", "is_line"), [(0.8, True), (0.05, False)])
def test_whiteheads_factor_is_a_line_unless_it_would_press_the_patterns_to_the_bottom(spread, is_line):
    panel = drawing("mistuned", mistuned(spread)).axes[0]
    (words,) = (text.get_text() for text in panel.texts)
    assert words.startswith("Whitehead (linear, one mode per blade): 2.23")
    assert (panel.get_ylim()[1] > 2.23) == is_line == ("beyond" not in words)


def test_what_a_search_has_found_is_shown_in_place_of_what_was_drawn():
    kinds = [
        entries(drawing("mistuned", mistuned(0.5, searched=searched)).axes[2].get_legend())
        for searched in (True, False)
    ]
    assert kinds == [["worst by gradient"], ["worst of those drawn"]]


def test_another_row_is_behind_in_grey():
    own, other = mistuned(0.5), mistuned(1.2)
    levels, amplitudes, pattern = drawing("mistuned", own, over=("mistuned", other)).axes
    grey = [line for line in amplitudes.lines if line.get_zorder() == BEHIND]
    assert {line.get_color() for line in grey} == {GREY}
    assert len(grey) == 3  # tuned, median pattern, worst
    largest = max(line.get_ydata().max() for line in amplitudes.lines)
    assert largest == pytest.approx(1e3 * other["amplitude"].max())
    assert amplitudes.get_ylim()[1] > largest
    # Nothing is in the legends twice.
    for panel in (levels, amplitudes, pattern):
        words = entries(panel.get_legend())
        assert len(words) == len({*words})


def test_rows_of_other_sigmas_are_not_drawn_over_one_another():
    two, other = mistuned(0.5), mistuned(0.5, sigmas=(0.01, 0.02))
    with pytest.raises(ValueError, match="the axes differ"):
        picture("mistuned", two, over=("mistuned", other))
    assert picture("mistuned", two, None, "amplitude", over=("mistuned", other)).axes
