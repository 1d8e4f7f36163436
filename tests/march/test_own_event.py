"""Events of one's own: penetration beyond a depth, which is counted and changes nothing.

They are defined here, and a pair and a row of three blades march with them without a change of the package. Beside it,
blades that move along x alone, without friction, are followed by a plain integrator in NumPy.
"""

import math
from functools import cache
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import jaxshroud as js
from jaxshroud.batch.lanes import begin_lanes, initial_states
from jaxshroud.batch.plan import Plan
from jaxshroud.batch.runs import run_lanes
from jaxshroud.cache.key import UnknownPartError, description
from jaxshroud.march.accumulator import Counters
from jaxshroud.march.event import ContactNow, Event, Guard, Guards, guards_after_event
from jaxshroud.march.events import EVENTS
from jaxshroud.march.logged import observables_of
from jaxshroud.march.method import FAST, Choices
from jaxshroud.march.tableau import TaylorOptions
from jaxshroud.model.arithmetic import where
from jaxshroud.model.modes import Mode
from jaxshroud.model.spring_contact import SpringContact
from jaxshroud.scene.checks import InputError
from jaxshroud.scene.grids import scenes_at


def beyond(depth: float, name: str) -> Event:
    """The event that the penetration grows beyond a depth [m]."""

    def guard(now: ContactNow) -> Guard:
        return Guard(now.at.v - depth, now.rate.v)

    return Event(name, f"penetration beyond {depth} m", guard)


DEEP = 1e-5  # [m]
GAMMAS = (2.0, 2.5, 3.0)  # one lane each
PERIODS, STEPS, FINE = 4, 400, 2000
SMOOTH_X = ('parts.motion=["x"]', "friction.mu=0")
LAYOUTS = {
    "pair": ("table1", SMOOTH_X),
    "row of three": ("row_ring12", ("row.blades=3", "row.closed=false", "drive.engine_order=1", *SMOOTH_X)),
}


@pytest.fixture(scope="module", params=LAYOUTS)
def layout(request):
    return request.param


def scene_in(layout):
    name, changes = LAYOUTS[layout]
    return js.load(name, list(changes)).scene


class Followed(NamedTuple):
    """A motion by RK4 in plain NumPy, with the axes (lane, instant, blade or interface)."""

    x: np.ndarray
    v: np.ndarray  # penetration


@cache
def followed(layout):
    blades = 2 if layout == "pair" else 3
    phase = math.pi * np.arange(2) if layout == "pair" else 2 * math.pi * np.arange(3) / 3
    m, k_x, c_x, gap, omega = 0.08, 1e5, 3.57, 22e-6, 536.0
    force, lean, k = 60.0 * math.cos(math.pi / 6), math.sin(math.pi / 3), np.array(GAMMAS)[:, None] * k_x

    def penetration(x):
        return (x[..., :-1] - x[..., 1:] - gap) * lean

    def slope(t, z):
        x, speed = z
        push = k * np.maximum(penetration(x), 0.0) * lean
        total = force * np.sin(omega * t + phase) - k_x * x - c_x * speed
        total[:, :-1] -= push
        total[:, 1:] += push
        return np.array([speed, total / m])

    h = 2 * math.pi / omega / FINE
    states = [np.zeros((2, len(GAMMAS), blades))]
    for i in range(PERIODS * FINE):
        t, z = i * h, states[-1]
        a = slope(t, z)
        b = slope(t + h / 2, z + h / 2 * a)
        c = slope(t + h / 2, z + h / 2 * b)
        states.append(z + h / 6 * (a + 2 * b + 2 * c + slope(t + h, z + h * c)))
    x = np.stack([z[0] for z in states], axis=1)
    return Followed(x, penetration(x))


def rises(v, depth, every=1):
    """How often samples have grown beyond a depth by the end of each period."""
    above = v[:, ::every] > depth
    rose = above[:, 1:] & ~above[:, :-1]
    return np.cumsum(rose.reshape(len(v), PERIODS, -1, v.shape[-1]).sum(axis=2), axis=1)


@cache
def depths(layout):
    """Depths [m]: 10 um, that of an onset, and one for each lane, which it exceeds for less than a step at a time."""
    peaks = {f"peak {i}": 0.9999 * np.max(v) for i, v in enumerate(followed(layout).v)}
    return {"deep": DEEP, "onset": 0.0, **peaks}


@cache
def marched(layout, events=None, locate="cubic"):
    """The run of all lanes, by default with events at all depths."""
    scenes = scenes_at(scene_in(layout), ["contact.gamma"], np.array(GAMMAS)[:, None])
    if events is None:
        events = tuple(beyond(depth, name) for name, depth in depths(layout).items())
    method = FAST._replace(events=events, locate=locate)
    return run_lanes(scenes, initial_states(scenes), Plan(0, PERIODS, STEPS, 0.0, method), lambda _: None)


def counts(run, name):
    """How often an event has happened in each lane and at each interface, by the end of each period."""
    return np.asarray(run.samples.own[name]).reshape(len(GAMMAS), PERIODS, -1)


@pytest.mark.full(but=["pair"])
def test_an_event_is_counted_as_often_as_many_samples_rise_beyond_the_depth(layout):
    run, v = marched(layout), followed(layout).v
    for name, depth in depths(layout).items():
        assert_array_equal(counts(run, name), rises(v, depth), err_msg=name)
    assert len(set(counts(run, "deep")[:, -1].ravel())) > 1  # lanes or interfaces differ
    # Controls: samples at ends of steps alone, and a march that does not locate events, miss short peaks.
    peaks = [name for name in depths(layout) if name.startswith("peak")]
    unlocated = marched(layout, locate="none")
    assert any(np.any(rises(v, depths(layout)[name], FINE // STEPS) < rises(v, depths(layout)[name])) for name in peaks)
    assert any(np.any(counts(unlocated, name) < counts(run, name)) for name in peaks)


@pytest.mark.full(but=["pair"])
def test_an_event_at_the_instant_of_an_onset_is_counted_beside_it(layout):
    run = marched(layout)
    onsets = run.log.counters.onset_slip
    assert_array_equal(counts(run, "onset")[:, -1], np.reshape(onsets, (len(GAMMAS), -1)))


@pytest.mark.full(but=["pair"])
def test_an_event_without_a_transition_does_not_change_the_motion(layout):
    true = followed(layout).x[:, FINE::FINE]
    x, plain = (np.reshape(run.samples.motion.x, true.shape) for run in (marched(layout), marched(layout, ())))
    # Trials end at the events: the motion differs by the error of a step that is made in two, which is a small part of
    # the error of the method.
    assert 0 < np.abs(x - plain).max() < 0.02 * np.abs(plain - true).max()
    assert np.abs(plain - true).max() < 1e-4 * np.abs(true).max()
    # Control: where no event is located, the built-in ones are not either.
    unlocated = np.reshape(marched(layout, locate="none").samples.motion.x, true.shape)
    assert np.abs(unlocated - plain).max() > 1e-3 * np.abs(true).max()


class Yielding(SpringContact):
    """A spring that is half as stiff from the event `YIELDS` on, until contact ends: the mode is SLIP_MINUS then."""

    def normal_force(self, v, mode):
        return where(mode == Mode.APART, 0.0, where(mode == Mode.SLIP_MINUS, 0.5, 1.0) * self.k * v)

    def stored_energy(self, v, w, mode):
        return self.normal_force(v, mode) * v / 2


YIELDS = Event(
    "yields",
    f"penetration beyond {DEEP} m of a stiff spring",
    guard=lambda now: Guard(where(now.state.mode == Mode.SLIP_PLUS, now.at.v - DEEP, -1.0), now.rate.v),
    transition=lambda _: jnp.int32(Mode.SLIP_MINUS),
    forces_jump=lambda _: True,
)


def yielding_by_hand(k):
    """The displacements of a pair at the end of each period, and how often its spring has yielded by then."""
    m, k_x, c_x, gap, omega, lean = 0.08, 1e5, 3.57, 22e-6, 536.0, math.sin(math.pi / 3)
    force, phase, h = 60.0 * math.cos(math.pi / 6), math.pi * np.arange(2), 2 * math.pi / omega / (10 * FINE)
    z, yielded, times, found = np.zeros((2, 2)), False, 0, []
    for i in range(PERIODS * 10 * FINE):
        v = (z[0, 0] - z[0, 1] - gap) * lean
        rises = not yielded and v > DEEP
        times, yielded = times + rises, (yielded or rises) and v > 0

        def slope(t, z, stiffness=k / 2 if yielded else k):
            push = stiffness * max((z[0, 0] - z[0, 1] - gap) * lean, 0.0) * lean
            total = force * np.sin(omega * t + phase) - k_x * z[0] - c_x * z[1] + push * np.array([-1, 1])
            return np.array([z[1], total / m])

        t, a = i * h, slope(i * h, z)
        middle = slope(t + h / 2, z + h / 2 * a)
        z = z + h * slope(t + h / 2, z + h / 2 * middle)  # third stage alone: the unlocated events err by more
        if (i + 1) % (10 * FINE) == 0:
            found.append((*z[0], times))
    return np.array(found)


def test_an_event_with_a_transition_changes_the_mode_and_the_forces():
    soft = js.with_contact_law(scene_in("pair"), Yielding(2.5e5))
    scenes = jax.tree.map(lambda a: jnp.asarray(a)[None], soft)
    method = FAST._replace(events=(YIELDS,), ledger=True)
    run = run_lanes(scenes, initial_states(scenes), Plan(0, PERIODS, STEPS, 0.0, method), lambda _: None)
    true, samples = yielding_by_hand(2.5e5), run.samples
    assert_array_equal(samples.own["yields"].reshape(-1), true[:, 2])
    x, size = samples.motion.x.reshape(PERIODS, 2), np.abs(true[:, :2]).max()
    assert np.abs(x - true[:, :2]).max() < 2e-3 * size  # of the reference, whose events end with its steps
    # The springs lose half of their energy at each event, which the balance counts.
    lost = true[-1, 2] * 2.5e5 * DEEP**2 / 4
    assert_allclose(-samples.switched.sum(), lost, rtol=1e-6)
    assert np.abs(samples.residual).max() < 1e-7 * samples.gross.max()
    # Control: without the event it is the article's spring.
    plain = run_lanes(scenes, initial_states(scenes), Plan(0, PERIODS, STEPS, 0.0, FAST), lambda _: None)
    assert np.abs(plain.samples.motion.x.reshape(PERIODS, 2) - true[:, :2]).max() > 0.05 * size


@pytest.mark.full
@pytest.mark.parametrize("name", ["table1", "table1_light"])
def test_events_are_counted_where_blocks_rub_and_turn(name):
    scene, levels = js.load(name).scene, (DEEP, 1e-4, 2e-4)
    method = FAST._replace(events=tuple(beyond(depth, f"beyond {depth}") for depth in levels))
    scenes = scenes_at(scene, ["contact.gamma"], np.array([[float(scene.contact.gamma)]]))
    run = run_lanes(scenes, initial_states(scenes), Plan(0, 2, 1600, 0.0, method), lambda _: None)
    v = np.asarray(js.simulate(scene, n_periods=2, method=js.RungeKutta("rk4", 25600)).v)
    got = [float(np.ravel(run.samples.own[event.name])[-1]) for event in method.events]
    assert got == [np.sum((v[1:] > depth) & (v[:-1] <= depth)) for depth in levels]
    assert len(set(got)) == len(levels)


@pytest.mark.full
def test_an_event_does_not_happen_where_a_march_begins_beyond_it():
    scene = js.load("table1", list(SMOOTH_X)).scene
    scenes = scenes_at(scene, ["contact.gamma"], np.array([[2.5]]))
    starts = eqx.tree_at(lambda state: state.motion.x, initial_states(scenes), jnp.asarray([[1e-4, 0.0]]))
    deep = beyond(DEEP, "deep")
    run = run_lanes(scenes, starts, Plan(0, 2, STEPS, 0.0, FAST._replace(events=(deep,))), lambda _: None)
    start = jax.tree.map(lambda a: a[0], starts)
    v = np.asarray(js.simulate(scene, start, n_periods=2, method=js.RungeKutta("rk4", FINE)).v)
    assert v[0] > DEEP
    assert run.samples.own["deep"][0, -1] == np.sum((v[1:] > DEEP) & (v[:-1] <= DEEP)) > 0


@pytest.mark.parametrize(
    ("low", "end", "after", "fire", "waits"),
    [
        (-1.0, 1.0, 1.0, True, False),  # the event itself
        (-1.0, 1.0, 1.0, False, True),  # another event took precedence at the same instant
        (-1.0, -1.0, 1.0, False, True),  # the guard jumped above zero at another event,
        (1.0, -1.0, 1.0, False, True),  # also after it had fallen
        (1.0, 1.0, 1.0, False, False),  # it was above zero before
        (1.0, 1.0, -1.0, False, False),  # it jumped below zero
    ],
)
def test_an_event_waits_while_another_happens_at_its_instant(low, end, after, fire, waits):
    own = len(EVENTS)
    guards = [Guards((jnp.asarray(-1.0),) * own + (jnp.asarray(a),), (), ()) for a in (after, end, low)]
    events = (*EVENTS, beyond(DEEP, "deep"))
    got, (waiting,) = guards_after_event(*guards, jnp.asarray(fire), jnp.int32(own), events)
    assert bool(waiting) is waits
    assert got.value[own] == (0.0 if waits else after)


def test_power_series_refuse_an_event_by_its_name():
    with pytest.raises(InputError, match="'deep'"):
        Choices(TaylorOptions(12, 1e-12), "series", events=(beyond(DEEP, "deep"),))


def test_contact_without_modes_refuses_an_event_by_its_name():
    smooth = js.load("table1", ["parts.contact=smooth", "contact.width=50 um"]).scene
    scenes = scenes_at(smooth, ["contact.gamma"], np.array([[2.5]]))
    with pytest.raises(InputError, match="'deep'"):
        begin_lanes(scenes, initial_states(scenes), FAST._replace(events=(beyond(DEEP, "deep"),)))


@pytest.mark.parametrize("name", ["deep", "v_max"])
def test_every_event_has_a_name_of_its_own(name):
    with pytest.raises(InputError, match=name):
        observables_of(FAST._replace(events=(beyond(DEEP, "deep"), beyond(0.0, name))))


def test_a_program_with_an_event_of_a_user_is_not_kept():
    description(FAST)  # control
    with pytest.raises(UnknownPartError):
        description(FAST._replace(events=(beyond(DEEP, "deep"),)))


def test_the_built_in_events_stand_in_one_table():
    assert [event.name for event in EVENTS[:4]] == ["lift", "turn", "height", "rub"]
    assert len({event.name for event in EVENTS}) == len(EVENTS)
    counted = [name for event in EVENTS for name in event.counters]
    assert sorted(counted) == sorted(Counters.__annotations__)  # each because of one event
