"""What is empty, traced, negative or named twice is refused in one line, and what has no samples says so."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxshroud as js
from jaxshroud.batch.rollout import rollout
from jaxshroud.io.measurements import measurements_from
from jaxshroud.signals.effects import between, with_interval
from jaxshroud.verbs.accuracy import accuracy_level

IN_X = ['parts.motion=["x"]']
HOW = {"n_periods": 2, "transient": 1, "method": js.RungeKutta(steps=100)}
SPEEDS = {"drive.omega": [500.0, 536.0]}
FORCES = {"drive.F_0": []}
BOUNDS = {"drive.engine_order": (0.0, 2.0)}
GAPS = {"shroud.gap[0]": [1e-5], "shroud.gap": [2e-5]}
MASSES = {"blades.m[0]": (0.07, 0.09), "blades.m": (0.07, 0.09)}


@pytest.fixture(scope="module")
def pair():
    return js.load("table1", IN_X).scene


@pytest.fixture(scope="module")
def ring():
    return js.load("row_ring12", [*IN_X, "row.blades=3", "drive.engine_order=1"]).scene


def none_of(scene):
    return jax.tree.map(lambda a: a[:0], js.scenes_from({"shroud.gap": [1e-5]}, scene))


def over_no_lanes(scene):
    return jax.vmap(lambda gap: rollout(js.vary(scene, "shroud.gap", gap), method=HOW["method"]).power)(jnp.zeros(0))


@pytest.mark.parametrize(
    ("call", "told"),
    [
        (lambda pair, ring: js.response(pair, start=1.0, stop=2.0, over={"friction.mu": []}), "at least one value"),
        (lambda pair, ring: js.scatter(pair, {"shroud.gap": 1e-6}, conditions=FORCES), "drive.F_0 has no value"),
        (lambda pair, ring: js.tune(pair, {"shroud.gap": (1e-5, 2e-5)}, conditions=FORCES), "drive.F_0 has no value"),
        (lambda pair, ring: js.report(pair, conditions=FORCES), "drive.F_0 has no value"),
        (lambda pair, ring: js.simulate(none_of(pair)), r"There are no scenes: their leading axes are \(0,\)"),
        (lambda pair, ring: js.power(none_of(ring)), r"There are no scenes: their leading axes are \(0,\)"),
        (lambda pair, ring: over_no_lanes(pair), "an axis of no lanes"),
        (lambda pair, ring: over_no_lanes(ring), "an axis of no lanes"),
        (lambda pair, ring: js.rollout(pair, save="N"), "`save` must be a function"),
        (
            lambda pair, ring: jax.jit(lambda gap: js.value_of(js.vary(pair, "shroud.gap", gap), "shroud.gap"))(1e-5),
            "take scene.shroud.gap itself",
        ),
        (
            lambda pair, ring: js.mistune(ring, SPEEDS, linear="stuck", direction="both"),
            'A linear row has one motion at each value, and no direction "both"',
        ),
        (lambda pair, ring: js.Row(3, closed="false"), "`closed` of a row must be True or False, but is 'false'"),
        (
            lambda pair, ring: js.Row(3, True, [[0.1, 0.1, 0.1]]),
            r"one mistuning for each blade",
        ),
        (
            lambda pair, ring: js.scenes_from(GAPS, ring),
            r"shroud.gap\[0\] and shroud.gap are, at least partly",
        ),
        (lambda pair, ring: js.sweep(ring, GAPS, **HOW), r"shroud.gap\[0\] and shroud.gap are, at least partly"),
        (lambda pair, ring: js.tune(pair, MASSES, **HOW), r"blades.m\[0\] and blades.m are, at least partly"),
        (
            lambda pair, ring: js.gradient(ring, "drive.engine_order", **HOW),
            "drive.engine_order is a whole number",
        ),
        (lambda pair, ring: js.tune(ring, BOUNDS, **HOW), "drive.engine_order is a whole number"),
        (lambda pair, ring: js.scatter(ring, BOUNDS, **HOW), "drive.engine_order is a whole number"),
        (
            lambda pair, ring: js.branch(ring, "drive.engine_order", 0.0, 2.0),
            "drive.engine_order is a whole number",
        ),
        (lambda pair, ring: js.response(ring, "drive.engine_order", 0.0, 2.0), "drive.engine_order is a whole number"),
    ],
)
def test_what_is_wrong_is_refused_in_one_line(pair, ring, call, told):
    with pytest.raises(js.InputError, match=told) as refused:
        call(pair, ring)
    assert len(str(refused.value).splitlines()) == 1


@pytest.mark.parametrize("name", ["x_rms_left", "theta_peak_right"])
def test_an_amplitude_is_not_negative(name):
    unit = "deg" if name.startswith("theta") else "mm"
    table = {"omega [rad/s]": [500.0, 536.0], f"{name} [{unit}]": [0.1, 0.0]}
    measurements_from(table)  # control: 0 is an amplitude
    with pytest.raises(js.InputError, match=f"{name} is an amplitude, and cannot be negative"):
        measurements_from({**table, f"{name} [{unit}]": [0.1, -0.1]})


def test_a_number_of_the_summary_that_is_unknown_is_told(pair):
    # JSON has None in place of NaN: one period has a P_d, but no interval.
    best = js.sweep(pair, SPEEDS, **HOW | {"n_periods": 1}).summary()["largest P_d"]
    assert best["ci"] is None
    assert with_interval(best["P_d"], best["ci"], "%").endswith("% (interval unknown)")
    assert between(None, None, None) == "nan (nan to nan)"


def test_a_sweep_without_samples_says_so_and_rows_have_gaps(pair, ring):
    swept = js.sweep(pair, SPEEDS, keep_samples=False, **HOW)
    with pytest.raises(js.InputError, match="keeps no samples"):
        swept.motion  # noqa: B018  reading is what fails
    np.testing.assert_array_equal(swept.gap, np.full(2, float(pair.shroud.gap)))


@pytest.mark.full
def test_gaps_of_a_swept_row_are_those_of_its_interfaces(ring):
    row = js.sweep(ring, SPEEDS, **HOW)
    np.testing.assert_array_equal(row.gap, np.broadcast_to(ring.shroud.gap, row.gap.shape))
    assert row.gap.shape == (2, 3)


def test_an_accuracy_may_be_an_array_of_one_number():
    assert accuracy_level(jnp.array(1e-3)) == 1e-3
    for wrong in (jnp.array([1e-3, 1e-4]), jnp.array(1.0)):
        with pytest.raises(js.InputError, match="must be fast, balanced, reference or a number"):
            accuracy_level(wrong)
