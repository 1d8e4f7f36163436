"""Models no larger than the scene: each is the limit of the full one, and what is absent is absent."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from side_by_side import EXACT, ends, run, sizes, with_parts

import jaxshroud as js
from jaxshroud.batch.lanes import begin_lanes, initial_states
from jaxshroud.batch.operation_count import lowered_operations, size_of_trial
from jaxshroud.march.method import FAST, FAST_WITH_LEDGER
from jaxshroud.model.linear import steady_amplitudes
from jaxshroud.model.modes import Status
from jaxshroud.scene.scene import Scene
from jaxshroud.scene.vary import vary

PERIODS, STEPS = 2, 400


def varied(scene: Scene, **changes) -> Scene:
    for key, value in changes.items():
        scene = vary(scene, key.replace("__", "."), value)
    return scene


def difference(reduced: Scene, full: Scene, periods: int = PERIODS, steps: int = STEPS) -> float:
    """Largest relative difference of all that moves in both."""
    a, b = (run([scene], periods, steps, FAST_WITH_LEDGER) for scene in (reduced, full))
    assert a.last.status == b.last.status == Status.OK
    moves = np.abs(ends(a)[0]) > 0
    error = np.abs(ends(a) - ends(b))[0][moves] / sizes(b)[0][moves]
    return float(np.max(error))


@pytest.mark.release
@pytest.mark.full
def test_no_friction_is_none_of_its_coefficient(table1):
    # mu = 0 and k_d = 0 are the same motion, to rounding.
    bare = with_parts(table1, friction="none")
    assert difference(bare, vary(table1, "friction.mu", 0.0)) < 1e-9
    assert difference(bare, vary(table1, "friction.k_d", 0.0)) < 1e-9
    assert difference(bare, vary(table1, "friction.mu", 0.1)) > 1e-2  # control


@pytest.mark.release(only=["changes2-overdamped"])
@pytest.mark.full
@pytest.mark.parametrize(
    ("changes", "name"),
    [
        ({}, "underdamped"),
        ({"blades__c_x": 2 * np.sqrt(0.08 * 1e5)}, "critically damped"),
        ({"blades__c_x": 1e3, "blades__c_y": 1e4}, "overdamped"),
        ({"blades__c_x": 0.0, "blades__c_y": 0.0, "blades__c_T": 0.0}, "undamped"),
    ],
)
def test_the_closed_form_at_any_damping(table1, changes, name):
    scene = varied(table1, initial__x=1e-4, initial__v_y=0.1, **changes)
    free = with_parts(scene, contact="none")
    stepped = run([vary(scene, "shroud.gap", 1.0)], 2, 2000, EXACT["dopri8-cubic"])
    got = js.sweep(free, {"drive.F_0": [60.0]}, n_periods=2, method=js.RungeKutta(steps=400), transient=0)
    size = sizes(stepped)[0].reshape(6, 2)
    for field, at, whole in zip(got.motion, stepped.samples.motion, size, strict=True):
        assert_allclose(field[0], at[0], rtol=0, atol=1e-9 * whole.max(), err_msg=name)


@pytest.mark.release
@pytest.mark.full
def test_samples_of_a_free_scene_lie_on_one_motion(table1):
    # Whole, in two parts from the first's end, and from another phase.
    free = with_parts(vary(table1, "initial.x", 1e-4), contact="none")
    whole = js.simulate(free, n_periods=2, method=js.RungeKutta(steps=100))
    first = js.simulate(free, n_periods=1, method=js.RungeKutta(steps=100))
    second = js.simulate(free, first.last, n_periods=1, method=js.RungeKutta(steps=100), t=float(first.t[-1]))
    assert_allclose(second.motion.x, whole.motion.x[100:], rtol=0, atol=1e-15)
    swept = js.sweep(
        free, {"drive.F_0": [60.0]}, n_periods=1, phase=np.pi / 2, method=js.RungeKutta(steps=400), transient=0
    )
    assert_allclose(swept.motion.x[0, 0], whole.motion.x[125], rtol=0, atol=1e-15)


@pytest.mark.release
@pytest.mark.full
def test_an_undamped_resonance_is_not_finite(table1):
    scene = varied(table1, drive__omega=float(np.sqrt(1e5 / 0.08)), blades__c_x=0.0)
    scene = vary(scene, "blades.k_x", 0.08 * float(scene.drive.omega) ** 2)
    free = with_parts(scene, contact="none")
    with pytest.warns(js.LaneWarning, match="NOT_FINITE"):
        got = js.sweep(free, {"drive.F_0": [60.0]}, n_periods=2, method=js.RungeKutta(steps=400), transient=0)
    assert got.status[0] == Status.NOT_FINITE
    assert np.isnan(got.P_d[0])
    with pytest.warns(js.LaneWarning, match="NOT_FINITE"):
        assert js.simulate(free, n_periods=2, method=js.RungeKutta(steps=10)).status == Status.NOT_FINITE


@pytest.mark.parametrize("ulps", [-2, -1, 0, 1, 2])
def test_a_free_amplitude_is_never_one_of_rounding(table1, ulps):
    # omega = sqrt(k / m) is rounded: k - m omega^2 is a few units of the last place, or none.
    scene = varied(table1, drive__omega=float(np.sqrt(1e5 / 0.08)), blades__c_x=0.0)
    k = 1e5 + ulps * float(np.spacing(1e5))
    free = steady_amplitudes(vary(scene, "blades.k_x", k))[1]
    assert np.isinf(np.abs(free.x)).all()
    assert np.isfinite(np.abs(free.y)).all()
    assert np.isfinite(np.abs(steady_amplitudes(vary(scene, "blades.k_x", k * (1 + 1e-12)))[1].x)).all()  # control


REDUCED = [
    {"motion": ("x", "y")},
    {"motion": ("x",)},
    {"friction": "none"},
    {"neighbour": "rigid"},
    {"motion": ("x",), "friction": "none", "neighbour": "rigid"},
    {"contact": "none"},
]


@pytest.mark.parametrize("parts", REDUCED, ids=str)
def test_what_is_absent_is_not_carried(table1, parts):
    scenes = jax.tree.map(lambda a: jnp.stack([a] * 2), with_parts(table1, **parts))
    lanes, full = (
        len(jax.tree.leaves(begin_lanes(s, initial_states(s), FAST)))
        for s in (scenes, jax.tree.map(lambda a: jnp.stack([a] * 2), table1))
    )
    assert lanes < full


COMBINED = ({"motion": ("x",)}, {"neighbour": "rigid"})  # in another one of them


@pytest.mark.release(
    only=[
        "{'friction': 'none'}",
        "{'motion': ('x', 'y')}",
        "{'motion': ('x',), 'friction': 'none', 'neighbour': 'rigid'}",
    ]
)
@pytest.mark.full
@pytest.mark.parametrize("parts", [parts for parts in REDUCED if parts not in COMBINED], ids=str)
def test_every_verb_runs(table1, parts):
    scene = with_parts(vary(table1, "contact.gamma", 0.3), **parts)
    one = js.simulate(scene, n_periods=2, method=js.RungeKutta(steps=100))
    assert one.status == Status.OK
    assert one.motion.theta.shape == (201, 2)
    assert abs(one.energy_residual) < 1e-3
    many = js.sweep(scene, {"drive.F_0": [50.0, 60.0]}, n_periods=8, method=js.RungeKutta(steps=100), transient=0)
    assert np.all(many.status == Status.OK)
    assert np.all(np.isfinite(many.P_d))
    found = js.orbit(scene, most_periods=400, method=js.RungeKutta(steps=100))
    assert found.found
    assert "stopped" not in found.flags
    slope = js.gradient(scene, ["shroud.gap", "drive.F_0"], orbit=found)
    assert np.all(np.isfinite(list(slope.value.values())))


def test_parts_that_do_not_exist_are_refused(table1):
    with pytest.raises(ValueError, match="`motion` must be one of"):
        with_parts(table1, motion=("y",))
    with pytest.raises(ValueError, match="`width` must be given for smooth contact"):
        with_parts(table1, contact="smooth")
    with pytest.raises(KeyError, match="not smooth"):
        vary(table1, "contact.width", 1e-7)


@pytest.mark.parametrize("parts", [{}, *REDUCED[:-1]], ids=str)
def test_operations_are_those_of_xla(table1, parts):
    # Counted by XLA's own analysis of cost, which differs in what it counts of broadcasts.
    scene = with_parts(table1, **parts)
    assert size_of_trial(scene, FAST).operations == pytest.approx(lowered_operations(scene, FAST), rel=0.1)


def test_a_scene_is_explained(table1):
    full, plain, free = (
        js.explain(with_parts(table1, **parts)) for parts in ({}, {"motion": ("x", "y")}, {"contact": "none"})
    )
    assert full.operations == full.full_operations == plain.full_operations
    assert plain.operations < 0.5 * full.operations
    assert plain.numbers < full.numbers
    assert plain.events == ("contact", "friction")
    assert (free.operations, free.numbers, free.events) == (0, 0, ())
    assert any("friction" in text for text in js.explain(vary(table1, "friction.mu", 0.0)).advice)
    assert any("gap" in text for text in js.explain(vary(table1, "shroud.gap", 1.0)).advice)


@pytest.mark.full
def test_blades_without_contact_are_apart_all_the_time(table1):
    found = js.sweep(
        with_parts(table1, contact="none"),
        {"friction.mu": [0.3, 0.5]},
        n_periods=3,
        transient=2,
        method=js.RungeKutta(steps=400),
    )
    assert_array_equal([found.time_apart, found.time_stick, found.time_slip], [[1, 1], [0, 0], [0, 0]])


@pytest.mark.release(only=["none"])
@pytest.mark.full
@pytest.mark.parametrize("contact", ["spring", "none"])
def test_a_motion_whose_energy_overflows_has_stopped(table1, contact):
    # The numbers of the state are finite, their squares are not, in float32.
    scene = vary(with_parts(table1, motion=("x",), contact=contact), "initial.x", 1e30)
    how = {"method": js.RungeKutta(steps=400, precision="float32")}
    with pytest.warns(js.LaneWarning, match="NOT_FINITE"):
        swept = js.sweep(scene, {"friction.mu": [0.5]}, n_periods=2, transient=0, **how)
    assert swept.status[0] == Status.NOT_FINITE
    assert np.isnan(swept.P_d[0])
    with pytest.warns(js.LaneWarning, match="NOT_FINITE"):
        assert js.power(scene, n_periods=2, transient=0, **how).final["status"] == Status.NOT_FINITE
    with pytest.warns(js.LaneWarning, match="NOT_FINITE"):
        assert js.simulate(scene, n_periods=1, **how).status == Status.NOT_FINITE
    with pytest.warns(js.LaneWarning, match="stopped"):
        assert js.orbit(scene, most_periods=8, method=js.RungeKutta(precision="float32")).flags == ("stopped",)


@pytest.mark.parametrize("wrong", [float("nan"), -1e-3])
def test_tolerances_are_numbers(table1, wrong):
    with pytest.raises(ValueError, match="`period_tol` must be a number of at least 0"):
        js.sweep(
            table1, {"friction.mu": [0.5]}, n_periods=2, period_tol=wrong, method=js.RungeKutta(steps=400), transient=0
        )
    with pytest.raises(ValueError, match="`period_tol` must be a number of at least 0"):
        js.power(table1, n_periods=2, period_tol=wrong, method=js.RungeKutta(steps=400), transient=0)
    with pytest.raises(ValueError, match="`stable_within` must be positive"):
        js.power(table1, n_periods=2, stable_within=wrong, method=js.RungeKutta(steps=400), transient=0)
    with pytest.raises(ValueError, match="`phase` must be in"):
        js.sweep(table1, {"friction.mu": [0.5]}, n_periods=2, phase=wrong, method=js.RungeKutta(steps=400), transient=0)
    for sigma in (wrong, 0.0, float("inf")):
        with pytest.raises(ValueError, match="`sigma` must be a positive number"):
            js.gradient(table1, ["shroud.gap"], sigma=sigma)
    with pytest.raises(ValueError, match="`tolerance` must be a positive number"):
        js.orbit(table1, tolerance=wrong)
