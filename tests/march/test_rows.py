"""Rows of blades against laws: a second opinion, the pair, identities of rings, closed forms, energy."""

import dataclasses
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import reference
import row_opinions
from numpy.testing import assert_allclose, assert_array_equal
from row_reference import RowParameters, simulate_row, table1_row
from row_runs import EXACT_ROW, part_of_period, row_scene_of, run_rows

import jaxshroud as js
from jaxshroud.batch.lanes import begin_lanes, initial_states, lane_models, lanes_at_start, lanes_last
from jaxshroud.batch.periods import CallLimits, Clock, at_start_of_period, run_block
from jaxshroud.batch.xla import best_mapping, vmapped
from jaxshroud.march import row_trial
from jaxshroud.march.carry import Fixed, time_grid
from jaxshroud.march.events import TURN, number_of
from jaxshroud.march.method import Choices
from jaxshroud.march.tableau import TaylorOptions
from jaxshroud.march.taylor_trial import taylor_trials
from jaxshroud.model.arithmetic import ZERO
from jaxshroud.model.modes import FLAT, Mode, Status
from jaxshroud.model.prepared import State
from jaxshroud.model.rhs import Recorded
from jaxshroud.model.row import prepared_row, row_rhs
from jaxshroud.orbits.short_runs import state_errors
from jaxshroud.scene.keys import Motion
from jaxshroud.scene.layout import Parts
from jaxshroud.scene.other_parts import with_parts

STEPS, FINE = 400, 6400
BY_SERIES = Choices(TaylorOptions(10, 1e-13), "series")


def ends_of(rows, periods, steps=STEPS, method=EXACT_ROW):
    """States (rows, 6, N) after so many periods; every run must end OK."""
    runs = run_rows([row_scene_of(p) for p in rows], periods, steps, method)
    assert_array_equal(runs.last.status, Status.OK)
    return runs.motion[:, -1]


def furthest(got, want):
    """The largest difference of states (..., 6, N), over the largest of its kind."""
    size = np.moveaxis(np.abs(want), -2, 0).reshape(want.shape[-2], -1).max(axis=1)[:, None]
    return float(np.max(np.abs(got - want) / np.where(size > 0, size, 1.0)))


def changed(p, name, place, by):
    """The row with one number of one blade or interface changed."""
    numbers = list(getattr(p, name))
    numbers[place] += by
    return dataclasses.replace(p, **{name: tuple(numbers)})


# --- the second opinion -------------------------------------------------------------------------------------------


JUDGED = {
    "chain of 3": (0, EXACT_ROW),
    "ring of 4": (1, EXACT_ROW),
    "chain of 3 by series": (0, BY_SERIES),
    "ring of 4 by series": (1, BY_SERIES),
    "ring of 6 by series": (3, BY_SERIES),
    "ring of 8 by series": (5, BY_SERIES),
}


@pytest.mark.release(only=["ring of 4", "ring of 8 by series"])
@pytest.mark.full(but=["chain of 3 by series"])
@pytest.mark.parametrize(("place", "method"), JUDGED.values(), ids=JUDGED)
def test_random_rows_are_those_of_the_second_opinion(place, method):
    rows = row_opinions.kept_rows(place)
    runs = run_rows([row_scene_of(row.parameters) for row in rows], row_opinions.PERIODS, FINE, method)
    assert_array_equal(runs.last.status, Status.OK)
    for lane, row in enumerate(rows):
        # A nudge of 1e-12 moves the end of a row by less than 1e-9: so may what both integrations err by. Blocks that
        # are apart may overlap at once when the corner that is next to the face changes: such an onset is located to
        # 2^-18 of a step, and its force jumps.
        assert furthest(runs.motion[lane], row.samples) < 1e-8
        counted = np.array([runs.counts(kind)[lane] for kind in reference.COUNTS])
        assert_array_equal(counted, row.counts)
    # The work of the drive that is not accounted for: rounding of some thousand steps.
    assert np.max(np.abs(runs.residual)) < 1e-12
    # Controls: an interface that is wider by a nanometre, and the interfaces in another order.
    wider = [changed(row.parameters, "gap", 0, 1e-9) for row in rows]
    swapped = [dataclasses.replace(row.parameters, gap=row.parameters.gap[::-1]) for row in rows]
    for wrong, least in ((wider, 1e-8), (swapped, 1e-3)):
        got = ends_of(wrong, row_opinions.PERIODS, method=method)
        deviations = [furthest(end, row.samples[-1]) for end, row in zip(got, rows, strict=True)]
        assert np.median(deviations) > least


def test_kept_opinions_are_those_of_the_second_opinion():
    row = row_opinions.kept_rows(0)[0]
    fresh = simulate_row(row.parameters, 1)
    # Plain Python rounds alike everywhere but in its libraries; impacts multiply that by some thousands.
    assert furthest(fresh.samples, row.samples[:1]) < 1e-9


# --- identities of rings ------------------------------------------------------------------------------------------


def package_phases(engine_order, blades):
    """The phases that a scene file gives the blades of a ring."""
    return js.load("row_ring12", [f"row.blades={blades}", f"drive.engine_order={engine_order}"]).scene.drive.phase


def ring(engine_order, blades=4, **changes):
    """A ring of alike blades under an engine order, its phases those of a scene file."""
    return table1_row(blades, True, **{"phase": package_phases(engine_order, blades), **changes})


def reflected(z):
    """The motion (..., 6, N) turned by half a turn: blade i is at -i, x and y change their signs, theta does not."""
    order = -np.arange(z.shape[-1]) % z.shape[-1]
    return (np.array([-1.0, -1, 1, -1, -1, 1])[:, None] * z)[..., order]


# Rings from rest: impacts, slip and case switches multiply the rounding of the phases by less than a hundred in five
# periods. Without a moment the faces are nearly parallel, and it is some hundreds in two. A nanometre of a gap of 22 um
# is a deviation that they multiply as well.
PERIODS, BENDING_PERIODS, ALIKE = 5, 2, 1e-11


@pytest.mark.full
def test_engine_orders_that_blades_cannot_tell_apart():
    orders = ring(1), ring(5), ring(-3), ring(2), changed(ring(5), "gap", 1, 1e-9)
    first, *same, other, control = ends_of(orders, PERIODS)
    assert max(furthest(end, first) for end in same) < ALIKE
    assert furthest(other, first) > 1e-2
    assert furthest(control, first) > 1e-8


@pytest.mark.full
def test_engine_orders_forward_and_backward_mirror_each_other_without_a_moment():
    backward = ring(-1, M_0=0.0)
    later = tuple(a + math.pi for a in backward.phase)  # half a period
    delayed = dataclasses.replace(backward, phase=later)
    rows = ring(1, M_0=0.0), delayed, backward, changed(delayed, "gap", 1, 1e-9)
    first, *others = ends_of(rows, BENDING_PERIODS)
    same, early, wider = (furthest(end, reflected(first)) for end in others)
    assert same < ALIKE
    assert early > 1e-2
    assert wider > 1e-8


@pytest.mark.release
@pytest.mark.full
def test_rings_of_other_sizes_under_the_same_interblade_phase_move_alike():
    small = ends_of([ring(1), ring(2)], PERIODS)
    large = [ring(3, 12), ring(6, 12)]
    wave, opposite, *controls = ends_of([*large, changed(large[0], "gap", 7, 1e-9), ring(1, 12)], PERIODS)
    for got, want in zip((wave, opposite), small, strict=True):
        assert furthest(got, np.tile(want, 3)) < ALIKE
    assert furthest(opposite[:, ::2], opposite[:, :1]) < ALIKE
    wider, slower = (furthest(got, np.tile(small[0], 3)) for got in controls)
    assert wider > 1e-8
    assert slower > 1e-2


@pytest.mark.full
def test_a_travelling_wave_with_impacts_and_friction():
    # Four times the damping settles the start to rounding in 40 periods.
    damping = {name: 4 * getattr(ring(1), name)[0] for name in ("c_x", "c_y", "c_T")}
    p, steps = ring(1, **damping), 200
    runs = run_rows([row_scene_of(p), row_scene_of(changed(p, "gap", 0, 1e-9))], 40, steps)
    assert min(runs.counts(kind)[0].min() for kind in ("onset_slip", "separation", "slip_stick")) >= 30
    now, later = runs.motion[:, -1], part_of_period(runs, steps // 4, steps)
    lag = lambda lane, by: furthest(later[lane], np.roll(now[lane], by, axis=-1))
    assert lag(0, -1) < 1e-10
    assert lag(0, 1) > 1e-1
    assert lag(1, -1) > 1e-7


@pytest.mark.full
def test_alike_blades_in_phase_do_not_feel_each_other():
    gaps = {"gap": 22e-6}, {"gap": -1e-4}, {"gap": 1.0}
    rows = [ring(0, M_0=0.0, **gap) for gap in gaps] + [ring(1, M_0=0.0)]
    runs = run_rows([row_scene_of(p) for p in rows], PERIODS, STEPS)
    end, power = runs.motion[:, -1], np.mean(runs.samples.power, axis=0)
    assert np.ptp(end[:3, :2], axis=-1).max() < 1e-15 * np.abs(end[:3, :2]).max()
    # Blocks that are pressed together all turn by the same angle: opposite forces on both faces are a couple.
    assert np.max(np.abs(power[0] / power[2] - 1)) < 1e-12
    assert np.max(np.abs(power[3] / power[2] - 1)) > 1e-1


# --- closed forms -------------------------------------------------------------------------------------------------


BENDING = Parts(motion=("x", "y"))


def stuck_frequencies(p):
    """The natural frequencies [Hz] of a row in bending with all interfaces stuck, from the model's accelerations."""
    scene = with_parts(row_scene_of(p), BENDING)
    model = lanes_last(jax.tree.map(lambda a: a[None], prepared_row(scene)))
    wave, interfaces = (jnp.zeros(1), jnp.ones(1)), (len(p.gap), 1)
    stuck = jnp.full(interfaces, Mode.STICK, jnp.int32), jnp.ones(interfaces, jnp.int32)

    def accelerations(q):
        x, y = q.reshape(2, p.blades, 1)
        motion = Motion(x, y, ZERO, jnp.zeros_like(x), jnp.zeros_like(y), ZERO)
        now = State(motion, jnp.zeros(interfaces), *stuck)
        a = row_rhs(wave, now, None, model, Recorded(), vmapped)[0].acceleration
        return jnp.concatenate([a.x[:, 0], a.y[:, 0]])

    stiffness = -jax.jit(jax.jacfwd(accelerations))(jnp.zeros(2 * p.blades))
    return np.sqrt(np.sort(np.linalg.eigvals(stiffness).real)) / (2 * math.pi)


def wave_frequencies(p, coupling):
    """The two natural frequencies [Hz] of K + coupling K_c, one pair for each coupling."""
    n, t = (math.sin(p.alpha), -math.cos(p.alpha)), (math.cos(p.alpha), math.sin(p.alpha))
    K_c = p.k[0] * np.outer(n, n) + p.k_d[0] * np.outer(t, t)
    D = np.diag([p.k_x[0], p.k_y[0]]) + np.multiply.outer(coupling, K_c)
    return np.sqrt(np.sort(np.linalg.eigvalsh(D / p.m[0]).ravel())) / (2 * math.pi)


@pytest.mark.full
def test_natural_frequencies_of_stuck_rows():
    got = stuck_frequencies(ring(0))
    printed = np.sort([177.94, 522.69, 522.69, 688.04, 974.62, 1224.71, 1224.71, 1446.13])
    assert_allclose(got, printed, atol=0.005)  # two decimals are known
    p, chain, h = ring(0, 12), table1_row(5, False), np.arange(12)
    assert_allclose(stuck_frequencies(p), wave_frequencies(p, 4 * np.sin(math.pi * h / 12) ** 2), rtol=1e-10)
    along, h = stuck_frequencies(chain), np.arange(5)
    assert_allclose(along, wave_frequencies(chain, 4 * np.sin(math.pi * h / 10) ** 2), rtol=1e-10)
    closed = wave_frequencies(chain, 4 * np.sin(math.pi * h / 5) ** 2)
    assert np.max(np.abs(along / closed - 1)) > 0.02  # control: a chain is not a ring


@pytest.mark.full
def test_a_maximum_right_after_an_event_does_not_hold_a_row_up():
    # A guard seemed to have a maximum 4e-16 of a step after an event: a trial that ended there left the clock where it
    # was, and so did all that followed, for ever.
    row = ["row.blades=12", "row.closed=true", "drive.engine_order=3", "drive.F_0=62"]
    scenes = js.stack_scenes([js.load("table1", row).scene])
    begin = at_start_of_period(begin_lanes(scenes, initial_states(scenes), EXACT_ROW))
    limits = CallLimits(jnp.int32(2), jnp.int32(3000))  # some 320 trials a period
    end, ended, _ = run_block(scenes, begin, Clock.of_steps(100), limits, EXACT_ROW, 2, best_mapping())
    assert (int(ended), end.lanes.status.tolist()) == (2, [Status.OK])


# --- rocking --------------------------------------------------------------------------------------------------------


def pressed_ring():
    """Three blades that are pressed together, with a small moment."""
    row = ["row.blades=3", "row.closed=true", "drive.engine_order=1"]
    return js.load("table1", [*row, "contact.gamma=2.5", "shroud.gap=-0.4 mm", "drive.M_0=1"]).scene


@pytest.mark.release
@pytest.mark.full
def test_faces_that_rock_with_their_neighbours_come_to_rest(monkeypatch):
    # Every turn of a face changes the torques of its neighbours, by which each would tell that its own rocking ends.
    scene, methods = pressed_ring(), [js.RungeKutta("dopri8", steps=steps) for steps in (100, 200)]
    coarse, fine = (js.simulate(scene, n_periods=1, method=method) for method in methods)
    assert (coarse.status, fine.status) == (Status.OK, Status.OK)
    size = np.abs(fine.motion.x).max()
    assert_allclose(coarse.motion.x[-1], fine.motion.x[-1], rtol=0, atol=1e-6 * size)  # found 5e-8
    assert coarse.counters["flat"].sum() > 0
    # Control: by the prediction of each interface alone the events of a step have no end.
    monkeypatch.setattr(row_trial, "most_turns", lambda grid: jnp.full(grid.turn.shape, 10**6, jnp.int32))
    with pytest.warns(js.LaneWarning):
        alone = js.sweep(scene, {"drive.M_0": [1.0]}, n_periods=1, transient=0, method=methods[0])
    assert alone.status.tolist() == [Status.TOO_MANY_EVENTS]


# Three light blades that rock, three periods from rest: by the second opinion, which resolves all 5,362 case switches
# (its bounds on the number of events apart).
LIGHT_RING = RowParameters(
    m=(0.05183813551361192, 0.08548142804263364, 0.09739182990615111),
    I=(2.46e-05,) * 3,
    k_x=(86397.54489944446, 141650.83720148337, 131056.98794547403),
    k_y=(3974909.8053062856, 1740508.7751700622, 1500737.5737205902),
    k_T=(2096.980454658508, 1975.9523860886836, 2607.5814342029903),
    c_x=(7.636544301960844, 6.289246741111372, 2.3188361843844976),
    c_y=(25.249799314321546,) * 3,
    c_T=(0.6371147253932091,) * 3,
    m_y=(0.05183813551361192, 0.08548142804263364, 0.09739182990615111),
    beta=(0.8240487050940887,) * 3,
    F_0=(88.56107233570107,) * 3,
    M_0=(1.5721896154777892,) * 3,
    phase=(0.0, 8.377580409572781, 16.755160819145562),
    gap=(5.91657575309579e-06,) * 3,
    k=(489902.81014340825, 199568.48333033692, 193068.99192557807),
    k_d=(922628.222027066, 236439.23102041852, 1479367.4949086865),
    mu=(0.28329045836979355,) * 3,
    omega=593.2827129083602,
    alpha=1.0479120352562896,
    l_oa=0.05,
    l_ab=0.035,
    closed=True,
    mistuning=(-0.029809489159672825, -0.039258573441071566, 0.0013580539299910968),
    initial=(0.0,) * 18,
)
LIGHT_RING_END = [
    [4.943369624387489e-06, 0.00013491835737509134, -0.00010810989580055462],
    [1.7756062470590129e-06, 3.29815076046298e-05, -5.234530761731242e-05],
    [-0.00018863810805048957, 0.00037787454060062925, -0.00036313783990260984],
    [0.2859276834160262, -0.01271033541605187, -0.13793438901515334],
    [0.0028410788495696125, -0.01746056092395978, -0.055816105218417435],
    [0.6261219561947713, -0.27382987510752277, -0.01481485673443476],
]


@pytest.mark.full
def test_the_share_of_a_period_decides_when_rocking_faces_become_flat_and_not_the_step():
    def run(steps, **flat):
        march = js.simulate(row_scene_of(LIGHT_RING), n_periods=3, method=js.RungeKutta("dopri8", steps, **flat))
        names = ("x", "y", "theta", "v_x", "v_y", "v_theta")
        error = state_errors(*np.array([[[getattr(march.motion, name)[-1] for name in names]], [LIGHT_RING_END]]))
        return float(error[0]), march.counters["flat"].sum(), float(march.energy_dropped)

    for steps in (200, 400):
        error, flat, dropped = run(steps)
        assert error < 1e-7  # found 4e-8 and 2e-8
        assert flat == 1
        assert dropped == pytest.approx(2.9e-11, rel=0.01)
        assert run(steps, flat_return=1 / 2400)[0] > 5e-6  # control: as at 100 steps, when the step decided
    # Without flat contact: a guard that rises and falls before another interface has its event was missed once (8e-6).
    assert run(200, flat_return=1e-7)[0] < 2e-7


# A ring of four pressed blades at the instant at which its last two faces have become flat. All are now, and share what
# they hold otherwise: the first and the last face open at once.
ALL_FLAT = Motion(
    x=[2.66100794606348e-05, 3.041246935291208e-05, -2.6807077993856713e-05, -3.0215470819690097e-05],
    y=[-2.05607386809429e-07, 1.917233518194839e-06, 2.5914114584954853e-07, -1.9707672772349725e-06],
    theta=[-0.0005185644158310996] * 4,
    v_x=[0.015493549776555518, 0.0019341694252374485, -0.015577067650933512, -0.0018506515508583375],
    v_y=[0.0010416282954007865, -0.0013703786830243387, -0.0010202458559761534, 0.0013489962435997156],
    v_theta=[2.9414548041573884e-05] * 4,
)


@pytest.mark.full
def test_a_face_that_has_just_become_flat_does_not_hide_what_is_due_at_another():
    keys = ["row.blades=4", "drive.engine_order=1", "shroud.gap=-0.2 mm", "friction.mu=1000"]
    scenes = jax.tree.map(lambda a: jnp.asarray(a)[None], js.load("row_ring12", keys).scene)
    method, steps, four = Choices(TaylorOptions(4, 1e-8), "series"), 200, jnp.ones((1, 4), jnp.int32)
    motion = jax.tree.map(lambda a: jnp.asarray([a]), ALL_FLAT, is_leaf=lambda a: isinstance(a, list))
    state = State(motion, jnp.full((1, 4), 0.000122362286421210), Mode.STICK * four, FLAT * four)
    model, periods = lane_models(scenes)
    fixed = Fixed(model, time_grid(jnp.zeros(1), jnp.full(1, float(steps)), periods), jnp.full(1, steps, jnp.int32))
    lane = lanes_at_start(state, model, method, vmapped)
    just = jnp.asarray([[number_of(TURN)], [-1], [number_of(TURN)], [-1]], jnp.int32)
    done = jnp.full(1, 0.752382333793182)
    lane = dataclasses.replace(lane, step=lane.step + 17, search=lane.search._replace(crossed=just, done=done))
    after = jax.jit(lambda lane: taylor_trials(lane, fixed, method, vmapped))(lane)
    assert after.state.case[3, 0] != FLAT
    assert_array_equal(after.state.mode, Mode.STICK)
    assert after.search.recheck[0]
