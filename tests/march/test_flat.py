"""Face-to-face contact: the limit of a relay, against a stiff rotational spring between the faces."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest
import reference
from numpy.testing import assert_allclose, assert_array_equal
from pair_views import contact_of, rates_in, view_in
from side_by_side import EXACT, counts, ends, energy_residual, relative_error, run, scene_of, sizes

import jaxshroud as js
from jaxshroud.batch.flows import as_differentiable
from jaxshroud.batch.tangents import direction, tangents
from jaxshroud.io.lane_status import LaneWarning
from jaxshroud.march.accumulator import Counters
from jaxshroud.march.method import (
    FAST_WITH_LEDGER,
    FLAT_RETURN,
    REFERENCE,
    RungeKutta,
    Taylor,
    method_as_json,
    method_from_json,
)
from jaxshroud.model.modes import FLAT, Mode, Status
from jaxshroud.model.prepared import State
from jaxshroud.model.row import prepared_row
from jaxshroud.scene.blades import Blades
from jaxshroud.scene.keys import Motion
from jaxshroud.scene.scene import Contact, Drive, Friction, Scene, Shroud
from jaxshroud.scene.vary import vary
from jaxshroud.verbs.simulate import simulate
from jaxshroud.verbs.sweep import sweep
from jaxshroud.verbs.trials import choose

SCENES = 50
SPRINGS = (1e2, 1e5, 1e6)  # [N m/rad]


def weak_torque(rng: np.random.Generator) -> reference.Parameters:
    """A random scene without torque, or with little of it, half of these pressed together from the start."""
    p = reference.random_parameters(rng)
    kind, weak = rng.integers(3), 10 ** rng.uniform(-4, -1)
    torque = (0.0, 0.0) if kind == 0 else tuple(weak * M for M in p.M_0)
    return dataclasses.replace(p, M_0=torque, gap=-p.gap if kind == 1 else p.gap)


@pytest.fixture(scope="module")
def weak():
    """Fifty random scenes that run through face-to-face contact within three periods."""
    rng = np.random.default_rng(5)
    drawn = [weak_torque(rng) for _ in range(90)]
    flat = counts(run([scene_of(p) for p in drawn], 3, 5000, FAST_WITH_LEDGER), "flat") > 0
    return [p for p, runs_flat in zip(drawn, flat, strict=True) if runs_flat][:SCENES]


@pytest.mark.full
@pytest.mark.parametrize("name", ["rk4-bisection", "rk4-cubic", "tsit5-cubic", "dopri8-cubic"])
def test_without_torque_from_rest(table1, name):
    # M_0 = 0: theta_1 = theta_2 for ever, and every contact is flat from its first instant.
    scene, method = vary(table1, "drive.M_0", 0.0), EXACT[name]
    order, steps = method.tableau.order, {"rk4": 1600, "tsit5": 400, "dopri8": 120}[method.tableau.name]
    truth = run([scene], 3, 8 * steps, method)
    coarse, fine = (run([scene], 3, n, method) for n in (steps, 2 * steps))
    assert counts(fine, "flat") == counts(fine, "onset_slip") + counts(fine, "onset_stick") > 5
    error = [relative_error(ends(r), ends(truth), sizes(truth))[0] for r in (coarse, fine)]
    assert fine.last.status == Status.OK
    assert np.log2(error[0] / error[1]) > order - 0.6
    assert np.abs(energy_residual(fine)) < 1e-7
    theta = truth.samples.motion.theta
    assert_array_equal(theta[..., 0], theta[..., 1])


def test_corner_contact_alone_is_a_relay_without_bound(table1):
    # Control: the second opinion knows no flat contact and gives up.
    assert reference.simulate(reference.table1(M_0=0.0), 1).status == "face_to_face"


@pytest.mark.full
def test_random_scenes_end_with_few_events_and_converge(weak):
    scenes = [scene_of(p) for p in weak]
    runs = {n: run(scenes, 3, n, FAST_WITH_LEDGER) for n in (10000, 20000, 40000)}
    for n, of in runs.items():
        assert np.all(of.last.status == Status.OK)
        assert np.all(counts(of, "flat") > 0)
        # A rocking that fades is followed until it returns within a part of the step: twice as long in half the steps.
        assert np.max(sum(counts(of, name) for name in Counters.__annotations__)) < 3 * 200 * n / 10000
        assert np.max(np.abs(energy_residual(of))) < 1e-7
    # What rounding and a sensitive scene leave: the energy of every lane closes at the march's order on the median.
    residual = [np.median(np.abs(energy_residual(of))) for of in runs.values()]
    assert residual[0] > 8 * residual[1]
    truth, (coarse, fine) = runs[40000], (runs[10000], runs[20000])
    error = [relative_error(ends(r), ends(truth), sizes(truth)) for r in (coarse, fine)]
    regular = error[0] < 1e-6
    assert np.mean(regular) > 0.75
    # RK4: errors against a run of half the step of the finer one fall 17-fold; a few scenes are at rounding.
    assert np.median(error[0][regular] / error[1][regular]) > 14


@pytest.mark.release
def test_it_is_the_limit_of_a_stiff_rotational_spring(weak):
    got = [towards_the_end_of_flat_contact(p) for p in weak]
    errors = np.array([springs_apart(p, *at) for p, at in zip(weak, got, strict=True) if at is not None])
    assert len(errors) > 0.8 * SCENES  # the others' first flat contact is too short to be sampled
    soft, stiff, stiffer, limit = errors.T
    # The difference falls as 1 / k_face; extrapolated to rigid faces, its next power and the march's error remain.
    assert np.median(stiff / stiffer) == pytest.approx(10, rel=0.1)
    assert np.mean(stiff / stiffer > 3) > 0.9
    assert np.median(limit) < 0.2 * np.median(stiffer)
    assert np.mean(limit < np.maximum(stiffer, 1e-5)) > 0.9
    assert np.median(soft) > 0.05  # control: a spring that is far too soft is told from flat contact


def towards_the_end_of_flat_contact(p: reference.Parameters, steps: int = 4000):
    """Time, state and size of the motion after 0.8 of the first flat contact; None where that is too short."""
    ours = simulate(scene_of(p), n_periods=3, method=RungeKutta(steps=steps))
    flat = ours.case == FLAT
    begin = int(np.argmax(flat))
    left = ~flat[begin:]
    length = int(np.argmax(left)) if left.any() else len(left)
    if length < 10:
        return None
    end = begin + int(0.8 * length)
    size = np.repeat([np.abs(a[: end + 1]).max() for a in ours.motion], 2)
    return float(ours.t[end]), np.concatenate([a[end] for a in ours.motion]), np.where(size > 0, size, 1.0)


def springs_apart(p: reference.Parameters, t: float, state: np.ndarray, size: np.ndarray) -> list[float]:
    """Relative differences for springs of the stiffnesses `SPRINGS`, and for the extrapolation of the last two."""
    runs = [reference._Run(dataclasses.replace(p, k_face=k_face), 1e-9) for k_face in SPRINGS]
    for spring in runs:
        spring.advance(t)
    z = [spring.y[:12] for spring in runs]
    return [float(np.max(np.abs(y - state) / size)) for y in (*z, (10 * z[-1] - z[-2]) / 9)]


@pytest.mark.full
def test_pressed_blocks_leave_flat_contact_at_a_corner(table1):
    # A torque that overcomes the moment of the contact forces lifts the faces off each other.
    scene = vary(vary(table1, "shroud.gap", -2e-4), "drive.M_0", 1.0)
    got = simulate(scene, n_periods=2, method=RungeKutta(steps=4000))
    assert got.status == Status.OK
    assert got.counters["flat"] == got.counters["flat_corner"] == 1
    assert got.counters["switch_14"] + got.counters["switch_23"] > 0
    theta = got.motion.theta[got.case == FLAT]
    assert_array_equal(theta[:, 0], theta[:, 1])
    assert abs(got.energy_residual) < 1e-8


@pytest.mark.release(only=["drive.F_0"])
@pytest.mark.full
@pytest.mark.parametrize("key", ["drive.F_0", "blades.I", "shroud.gap", "drive.omega"])
def test_derivatives_through_flat_contact(table1, key):
    scene = vary(vary(vary(table1, "shroud.gap", -2e-4), "drive.M_0", 1.0), "blades.I", np.array([2.46e-3, 2.3e-3]))
    start = simulate(scene, n_periods=1, method=RungeKutta(steps=2000, locate="bisection")).last
    along = [direction(scene, key)]
    of = lambda scene: tangents(
        scene, start, along, n=1, steps=2000, method=as_differentiable(REFERENCE), by_state=False
    )
    exact = of(scene).by_parameter[:, 0]
    step = 1e-6 * np.max(np.abs(value(scene, key)))
    up, down = (of(shifted(scene, key, sign * step)).vector for sign in (1, -1))
    difference = (up - down) / (2 * step)
    assert_allclose(exact[:12], difference[:12], atol=1e-6 * np.abs(difference[:12]).max())


def value(scene, key: str) -> np.ndarray:
    table, name = key.split(".")
    return np.asarray(getattr(getattr(scene, table), name))


def shifted(scene, key: str, step: float):
    return vary(scene, key, value(scene, key) + step)


def realistic_blade(gamma: float) -> Scene:
    """A blade whose inertia is its block's own, with a moment that its faces feel."""
    blades = Blades(0.095, 3.2e-5, 3.17e4, 3e6, 2000.0, 3.57, 19.6, 0.506, 0.095)
    shroud = Shroud(np.pi / 3, 42e-3, 30e-3, 0.05e-3)
    drive = Drive(578.0, np.pi / 6, 40.0, 1.0, (0.0, np.pi))
    return Scene(blades, shroud, Contact(gamma * 3.17e4, None), Friction(1e6, 0.3), drive)


@pytest.mark.full(but=["200"])
@pytest.mark.parametrize("steps", [200, 526, 1000, 3000])
def test_a_realistic_blade_does_not_stop(steps):
    # It leaves flat contact at the end of the faces' overlap, which is a slide shorter than the face: judged by the
    # whole face, contact at the corner pushed it back at once, 33 times within a step.
    got = run([realistic_blade(gamma) for gamma in np.linspace(0.1, 20, 64)], 5, steps, FAST_WITH_LEDGER)
    assert np.all(got.last.status == Status.OK)
    assert np.sum(counts(got, "flat_corner") > 0) > 8


@pytest.mark.parametrize("mode", [Mode.STICK, Mode.SLIP_PLUS, Mode.SLIP_MINUS])
def test_torques_at_the_ends_of_the_overlap_are_those_of_its_corners(mode):
    row, rng = prepared_row(realistic_blade(2.5)), np.random.default_rng(3)
    highs = 0
    for _ in range(12):
        held, wave = pressed_flat(rng, mode), tuple(map(jnp.asarray, rng.uniform(-1, 1, 2)))
        torque = {case: torque_in(held, wave, case, row) for case in (1, 2, 3, 4)}
        for case in range(1, 6):  # from whichever corner it is looked at
            view = view_in(with_case(held, case), row, wave)
            ends = (torque[3], torque[2]) if view.at.height > 0 else (torque[4], torque[1])
            assert_allclose(view.torques, ends, rtol=0, atol=1e-12)
        highs += int(view.at.height > 0)
        # Control: the whole face instead of the overlap.
        face = view.torques.lower - float(contact_of(row).law.normal_force(view.at.v, held.mode)) * 30e-3
        assert abs(face - view.torques.upper) > 1e-4 * abs(ends[0] - ends[1])
    assert 0 < highs < 12


def pressed_flat(rng: np.random.Generator, mode: Mode) -> State:
    """Parallel blocks some tenths of a millimetre into each other, slid against each other by as much."""
    number = lambda size: jnp.asarray(rng.uniform(-size, size))
    theta, turning = number(1e-3), number(1.0)
    x, y, v_x, v_y = ((number(s), number(s)) for s in (1e-5, 2e-4, 0.1, 0.1))
    motion = Motion((x[0] + 4e-4, x[1]), y, (theta, theta), v_x, v_y, (turning, turning))
    return State(motion, number(1e-4), jnp.int32(mode), jnp.int32(5))


def with_case(held: State, case: int) -> State:
    return State(held.motion, held.u_s, held.mode, jnp.int32(case))


def torque_in(held: State, wave, case: int, row) -> float:
    """Reduced inertia times the acceleration of theta_1 - theta_2 in contact at a corner, by Eq. (1)."""
    left, right = rates_in(with_case(held, case), row, wave).acceleration.theta
    return float(contact_of(row).mobility.joint * (left - right))


@pytest.mark.full
def test_what_flat_contact_drops_is_a_term_of_the_balance():
    scenes = [realistic_blade(gamma) for gamma in np.linspace(0.1, 20, 64)]
    shares = []
    for longer in (1, 4):
        method = EXACT["dopri8-cubic"]._replace(flat_return=longer * FLAT_RETURN)
        samples = run(scenes, 5, 200, method).samples
        assert np.max(np.abs(samples.residual) / samples.gross) < 1e-8
        shares.append(np.max(samples.dropped / samples.gross))
        # Control: a balance without this term.
        assert np.max(np.abs(samples.residual - samples.dropped) / samples.gross) > 0.9 * shares[-1]
    # What counts as flat decides what is dropped.
    assert 1e-10 < shares[0] < shares[1] / 4 < 1e-6


@pytest.mark.release
@pytest.mark.full
def test_chatter_is_told_with_its_cure():
    # The printed levers contradict each other where the cases meet, and flat contact is not in print.
    blade = realistic_blade(2.5)
    contact = Contact(blade.contact.k, None, frozenset({"levers"}))
    scene = Scene(blade.blades, blade.shroud, contact, blade.friction, blade.drive, blade.initial)
    gammas, how = {"contact.gamma": np.linspace(0.5, 20, 64)}, {"method": RungeKutta(steps=400), "transient": 0}
    with pytest.warns(LaneWarning, match="TOO_MANY_EVENTS"):
        curve = sweep(scene, gammas, n_periods=20, **how)
    lane = np.argmax(curve.status == Status.TOO_MANY_EVENTS)
    period = 1 + np.isfinite(curve.motion.x[lane, :, 0]).sum()
    assert f"of period {period} " in curve.chatter
    assert "flat_corner" in curve.chatter
    assert 'reading = "consistent"' in curve.chatter


@pytest.mark.release
@pytest.mark.full
def test_motions_of_chattering_faces_do_not_jump(table1):
    # Seven hundred switches in a period, some beside a slip that had come before: a switch that is zero to rounding
    # must not hide it. Neighbours 2e-9 apart in k then jumped by 1e-5 of the motion.
    blades = table1
    for key, value in {"blades.I": 2.46e-5, "drive.M_0": 0.5, "drive.F_0": 60.0, "shroud.gap": 22e-6}.items():
        blades = vary(blades, key, value)
    gamma = 14.097 * (1 + np.linspace(-1e-6, 1e-6, 33))
    how = {"n_periods": 1, "transient": 0, "method": RungeKutta("dopri8", steps=800)}
    run = sweep(blades, {"contact.gamma": gamma}, **how)
    assert np.ptp(run.counters["switch_23"]) == 0, run.counters["switch_23"]
    x = np.ravel(run.data["x"].isel(blade=0))
    assert np.max(np.abs(np.diff(x, 2))) < 1e-11 * np.max(np.abs(x))


# --- the share of a period within which rocking faces become flat -----------------------------------------------------


@pytest.mark.parametrize("share", [0, -1e-3, 2.0, float("nan"), "short", True])
@pytest.mark.parametrize("kind", [RungeKutta, Taylor])
def test_a_share_that_is_none_is_refused(kind, share):
    with pytest.raises(ValueError, match="Argument `flat_return` must be a number above 0 and at most 1"):
        kind(flat_return=share)


@pytest.mark.parametrize("method", [RungeKutta("dopri8", 200, flat_return=1e-3), Taylor(flat_return=1e-4)])
def test_files_hold_the_share(method):
    assert method_from_json(method_as_json(method)) == method
    assert method.replace(precision="float32").flat_return == method.flat_return


@pytest.mark.full
def test_an_accuracy_sets_the_share():
    row = js.scenes_from({"contact.gamma": [2.5]}, js.load("row_ring12").scene)
    shares = [choose(row, 1, level, lane_periods=0).method.flat_return for level in (1e-3, 1e-6, 1e-9)]
    assert_allclose(shares, [1 / 2423, 1 / 38400, 1 / 608600], rtol=1e-3)
    lanes = js.scenes_from({"contact.gamma": [2.5]}, js.load("table1").scene)
    assert choose(lanes, 1, 1e-6).method.flat_return == pytest.approx(4 / 38400)  # where trials say that it is enough


@pytest.mark.full
@pytest.mark.parametrize("share", [1 / 2400, 1 / 38400])
def test_a_verb_marches_by_the_share_of_its_method(share):
    # Nearly parallel faces, at a step that is longer than either share.
    scene = js.load("table1", ["blades.I=2.46e-5", "drive.M_0=0.3", "shroud.gap=-20 um"]).scene
    run = js.simulate(scene, n_periods=1, method=RungeKutta("rk4", 100, flat_return=share))
    longer = js.simulate(scene, n_periods=1, method=RungeKutta("rk4", 100, flat_return=1.0))
    assert (run.counters["switch_23"] > longer.counters["switch_23"]) == (share < 1 / 2400)
