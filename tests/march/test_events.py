"""Guards that end a contact mode, and what changes when one is crossed (the bilinear element, the four cases)."""

import itertools

import equinox as eqx
import exact
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from exact import CASES, CONSISTENT
from numpy.testing import assert_allclose
from pair_views import contact_of, view_in

from jaxshroud.march import events
from jaxshroud.march.accumulator import Counters, count_event
from jaxshroud.march.carry import Target
from jaxshroud.march.event import GuardEvaluation, Guards, first_kind
from jaxshroud.march.events import Transition, transition
from jaxshroud.march.locate import first_crossed
from jaxshroud.march.observable import Ending
from jaxshroud.model.modes import Mode
from jaxshroud.model.prepared import State
from jaxshroud.model.row import RowModel, prepared_row
from jaxshroud.scene.scene import Contact
from jaxshroud.scene.vary import vary

K, K_D, MU = 1e6, 5e5, 0.4
LAG = MU * K / K_D  # stretch in slip per penetration
V, H = 1e-4, 2e-4  # [m] penetration and height of the corners used below
THETA = {1: (0.03, -0.01), 2: (0.03, -0.01), 3: (-0.01, 0.03), 4: (-0.01, 0.03)}
HEIGHT = {1: -H, 2: H, 3: H, 4: -H}
CONTACTS = (Mode.STICK, Mode.SLIP_PLUS, Mode.SLIP_MINUS)
SLIPS = CONTACTS[1:]
SIGMA = {Mode.STICK: 0, Mode.SLIP_PLUS: 1, Mode.SLIP_MINUS: -1}
GAP_SIGN = frozenset({"gap_sign"})
FOUR = AT_LIFT, AT_TURN, AT_HEIGHT, AT_RUB = [
    events.number_of(event) for event in (events.LIFT, events.TURN, events.HEIGHT, events.RUB)
]


@pytest.fixture(scope="module")
def scene(table1):
    varied = table1
    for key, value in {"contact.k": K, "friction.k_d": K_D, "friction.mu": MU}.items():
        varied = vary(varied, key, value)
    return varied


@pytest.fixture(scope="module")
def sides(scene):
    return exact.Sides(*(float(value) for value in vars(scene.shroud).values() if value is not None))


@pytest.fixture(scope="module")
def ready(scene):
    return prepared_row(scene)


def held_at(q, rate, mode: Mode, case: int, u_s: float = 0.0) -> State:
    z = jax.tree.map(jnp.asarray, exact.motion(q, rate))
    return State(z, jnp.asarray(u_s), jnp.int32(mode), jnp.int32(case))


@eqx.filter_jit
def seen(held: State, row: RowModel) -> GuardEvaluation:
    return view_in(held, row)


@eqx.filter_jit
def _crossed(held: State, kind: jax.Array, row: RowModel, late: jax.Array) -> tuple[Transition, GuardEvaluation]:
    event = transition(held, view_in(held, row), kind, late, jnp.asarray(0.0), contact_of(row))
    return event, view_in(State(held.motion, event.after.u_s, event.after.mode, event.after.case), row)


def crossed(held: State, kind: int, row: RowModel, late: float = 0.0) -> tuple[Transition, GuardEvaluation]:
    """The transition, and where the corners are after it."""
    return _crossed(held, jnp.int32(kind), row, jnp.asarray(late))


def values(held: State, row: RowModel) -> np.ndarray:
    """The guards of the events that end a mode or a case."""
    guards = seen(held, row).guards
    return np.array([guards.value[kind] for kind in FOUR])


def force(view: GuardEvaluation, state: State, row: RowModel) -> float:
    return float(contact_of(row).law.friction_force(view.at.v, view.at.u, state.u_s, state.mode))


def inside(sides, mode: Mode, case: int, v=V, height=None, theta=None, v_rate=0.0, u_rate=None, w=0.5) -> State:
    """A state well inside one mode and case; `w` is the stretch in stick as a fraction of its limit."""
    theta, height = theta or THETA[case], HEIGHT[case] if height is None else height
    q = exact.placed(sides, case, theta, v, height)
    u_rate = SIGMA.get(mode, 0) * 0.1 if u_rate is None else u_rate
    u_s = exact.penetration_and_slide(sides, q, case)[1] - w * LAG * v
    return held_at(q, exact.approach(sides, case, theta, v_rate, u_rate), mode, 0 if mode == Mode.APART else case, u_s)


@pytest.mark.parametrize("case", CASES)
def test_guards_are_negative_inside_their_mode_and_case(sides, ready, case):
    for mode in CONTACTS:
        assert np.all(values(inside(sides, mode, case), ready) < 0)
    assert np.all(values(inside(sides, Mode.APART, case, v=-V), ready) < 0)


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("mode", CONTACTS)
def test_one_guard_turns_positive_where_its_mode_ends(sides, ready, mode, case):
    def violated(**changes) -> list[int]:
        return np.flatnonzero(values(inside(sides, mode, case, **changes), ready) > 0).tolist()

    # Where N has just gone, so has the friction limit: only the lift-off's own guard is asked for.
    assert AT_LIFT in violated(v=-1e-6)
    assert violated(theta=THETA[case][::-1]) == [AT_TURN]
    assert violated(height=-HEIGHT[case]) == [AT_HEIGHT]
    if mode == Mode.STICK:
        assert violated(w=1.01) == violated(w=-1.01) == [AT_RUB]
        assert violated(w=0.99) == violated(w=-0.99) == []
    else:
        sigma = SIGMA[mode]
        assert violated(u_rate=-sigma * 0.1) == [AT_RUB]
        # The slider stops before the corner does where N grows, and after it where N falls: u' = 0 is no guard.
        assert violated(u_rate=sigma * 0.1, v_rate=1.01 * 0.1 / LAG) == [AT_RUB]
        assert violated(u_rate=sigma * 0.1, v_rate=0.99 * 0.1 / LAG) == []
        assert violated(u_rate=-sigma * 0.1, v_rate=-1.01 * 0.1 / LAG) == []


@pytest.mark.parametrize("case", CASES)
def test_apart_only_the_approach_counts_and_the_case_follows_the_position(sides, ready, case):
    for v in (-V, V):
        held = inside(sides, Mode.APART, case, v=v)
        lift, *others = values(held, ready)
        assert_allclose(lift, v, rtol=1e-11)
        assert max(others) < 0
        assert int(seen(held, ready).case) == case


@pytest.mark.full
@pytest.mark.parametrize("reading", [CONSISTENT, GAP_SIGN])
def test_rates_of_the_guards_are_their_derivatives(scene, reading):
    # Along uniform motion: LIFT, TURN, HEIGHT and RUB in stick depend on the position alone. In slip RUB is itself
    # a rate, that of `slid`.
    ready = prepared_row(eqx.tree_at(lambda s: s.contact, scene, Contact(scene.contact.k, None, reading)))
    rng = np.random.default_rng(8)
    q, rate = rng.normal(0, 1e-3, (200, 6)), rng.normal(0, 0.1, (200, 6))
    q[:, 4:] += rng.uniform(-0.3, 0.3, (200, 2))

    @jax.jit
    @jax.vmap
    def guards_and_derivatives(q, rate, mode, case):
        def guards(q):
            held = State(exact.motion(q, rate), jnp.asarray(1e-4), mode, case)
            return view_in(held, ready).guards

        return guards(q), jax.jvp(guards, (q,), (rate,))[1]

    mode = rng.integers(0, 4, 200).astype(np.int32)
    case = np.where(mode == Mode.APART, 0, rng.integers(1, 5, 200)).astype(np.int32)
    got, derivative = guards_and_derivatives(*map(jnp.asarray, (q, rate, mode, case)))
    slip = mode >= Mode.SLIP_PLUS
    for kind in FOUR:
        asked = ~slip if kind == AT_RUB else slice(None)
        assert_allclose(got.rate[kind][asked], derivative.value[kind][asked], rtol=1e-11, atol=1e-13)
    assert_allclose(got.value[AT_RUB][slip], derivative.integral[AT_RUB][slip], rtol=1e-11, atol=1e-13)
    assert not np.any(np.asarray(got.integral[AT_RUB])[~slip])


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize(
    ("u_rate", "mode"),
    [
        (1.01 * LAG, Mode.SLIP_PLUS),
        (0.99 * LAG, Mode.STICK),
        (0.0, Mode.STICK),
        (-0.99 * LAG, Mode.STICK),
        (-1.01 * LAG, Mode.SLIP_MINUS),
    ],
)
def test_onset_slips_where_the_corner_is_faster_than_the_limit_grows(sides, ready, case, u_rate, mode):
    # k_d |u'| against mu k v', here with v' = 1 m/s.
    event, after = crossed(inside(sides, Mode.APART, case, v=0.0, v_rate=1.0, u_rate=u_rate), AT_LIFT, ready)
    assert (int(event.after.mode), int(event.after.case)) == (mode, case)
    assert_allclose(event.after.u_s, after.at.u, rtol=0, atol=1e-18)  # the spring is unstretched
    assert abs(force(after, event.after, ready)) < 1e-9
    assert abs(float(event.energy)) < 1e-18


def test_onset_without_friction_slides(sides, scene):
    ready = prepared_row(vary(scene, "friction.mu", 0.0))
    for u_rate, mode in ((0.1, Mode.SLIP_PLUS), (-0.1, Mode.SLIP_MINUS)):
        event, _ = crossed(inside(sides, Mode.APART, 3, v=0.0, v_rate=1.0, u_rate=u_rate), AT_LIFT, ready)
        assert int(event.after.mode) == mode
        # ... for ever: reversed, it still slides, without force.
        held = inside(sides, mode, 3, u_rate=-0.1 * SIGMA[mode])
        assert values(held, ready)[AT_RUB] < 0
        assert force(seen(held, ready), held, ready) == 0.0


@pytest.mark.parametrize(("late", "used"), [(1.0, 0.5e-6), (1e-7, 1e-7), (0.0, 0.0)])
def test_touch_down_is_led_back_to_first_contact_within_the_bracket(sides, ready, late, used):
    # Located v = 0.5 um late at v' = 1 m/s: the corner touched 0.5 us ago, if the bracket is that wide.
    held = inside(sides, Mode.APART, 1, v=0.5e-6, v_rate=1.0, u_rate=2.0)
    event, after = crossed(held, AT_LIFT, ready, late)
    assert_allclose(after.at.u - event.after.u_s, 2.0 * used, rtol=0, atol=1e-15)


@pytest.mark.parametrize("mode", CONTACTS)
def test_separation_leaves_nothing(sides, ready, mode):
    for case in CASES:
        held = inside(sides, mode, case, v=0.0, v_rate=-1.0)
        event, after = crossed(held, AT_LIFT, ready)
        assert (int(event.after.mode), int(event.after.case)) == (Mode.APART, 0)
        assert force(after, event.after, ready) == 0.0
        assert abs(float(event.energy)) < 1e-18
    # Under load (a chatter's end), what the springs still held is booked as lost.
    event, _ = crossed(inside(sides, mode, 1), AT_LIFT, ready)
    share = 0.5 if mode == Mode.STICK else 1.0
    assert_allclose(event.energy, -(K * V**2 + K_D * (share * LAG * V) ** 2) / 2, rtol=1e-10)


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize(("w", "mode"), [(1.0, Mode.SLIP_PLUS), (-1.0, Mode.SLIP_MINUS)])
def test_stick_to_slip_keeps_the_force(sides, ready, case, w, mode):
    held = inside(sides, Mode.STICK, case, w=w)
    before = force(seen(held, ready), held, ready)
    event, after = crossed(held, AT_RUB, ready)
    assert (int(event.after.mode), int(event.after.case)) == (mode, case)
    assert_allclose(before, w * MU * K * V, rtol=1e-10)
    assert_allclose(force(after, event.after, ready), before, rtol=1e-10)
    assert abs(float(event.energy)) < 1e-10 * K * V**2


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("mode", SLIPS)
def test_slip_to_stick_freezes_the_slider_where_it_is(sides, ready, case, mode):
    held = inside(sides, mode, case)
    before = force(seen(held, ready), held, ready)
    event, after = crossed(held, AT_RUB, ready)
    assert (int(event.after.mode), int(event.after.case)) == (Mode.STICK, case)
    assert_allclose(after.at.u - event.after.u_s, SIGMA[mode] * LAG * V, rtol=1e-10)
    assert_allclose(force(after, event.after, ready), before, rtol=1e-10)
    assert abs(float(event.energy)) < 1e-10 * K * V**2


SWITCHES = [
    *((AT_TURN, {"theta": (0.02, 0.02)}, pair) for pair in ((1, 4), (4, 1), (2, 3), (3, 2))),
    *((AT_HEIGHT, {"height": 0.0}, pair) for pair in ((1, 2), (2, 1), (3, 4), (4, 3))),
]


@pytest.mark.parametrize(("kind", "place", "pair"), SWITCHES)
@pytest.mark.parametrize("mode", CONTACTS)
def test_a_loaded_case_switch_carries_the_stretch(sides, ready, mode, kind, place, pair):
    held = inside(sides, mode, pair[0], **place)
    event, after = crossed(held, kind, ready)
    assert (int(event.after.mode), int(event.after.case)) == (mode, pair[1])
    q = np.array([*held.motion.x, *held.motion.y, *held.motion.theta])
    v, u = exact.penetration_and_slide(sides, q, pair[1])
    assert_allclose([after.at.v, after.at.u], [v, u], rtol=0, atol=1e-17)
    w_old, w = (0.5 * LAG * V,) * 2 if mode == Mode.STICK else (SIGMA[mode] * LAG * V, SIGMA[mode] * LAG * v)
    if mode == Mode.STICK:
        assert_allclose(u - event.after.u_s, w, rtol=0, atol=1e-17)
    assert_allclose(force(after, event.after, ready), K_D * w, rtol=1e-10)
    jump = (K * (v**2 - V**2) + K_D * (w**2 - w_old**2)) / 2
    assert_allclose(event.energy, jump, rtol=0, atol=1e-11 * K * V**2)
    if kind == AT_TURN:  # same v, same u: potential and slide are continuous
        assert_allclose(v, V, rtol=1e-11)
    else:  # control: the face turns from alpha - theta_2 to alpha - theta_1, so v does jump
        assert abs(v / V - 1) > 0.01
        assert abs(float(event.energy)) > 0.01 * K * V**2 / 2


def test_the_first_violated_guard_takes_precedence():
    for flags in itertools.product([False, True], repeat=4):
        want = flags.index(True) if any(flags) else AT_RUB
        assert int(first_kind(dict(enumerate(map(jnp.asarray, flags))))) == want


@pytest.mark.parametrize(("late", "first"), [(1e-20, AT_RUB), (2e-7, AT_RUB), (4e-7, AT_TURN)])
def test_a_turn_right_after_another_is_not_taken_for_earlier_than_a_stick(late, first):
    """A guard that has just been crossed is zero at both ends of its bracket; a third of the width is above zero."""
    rate, width = 0.2, 3e-6
    zero = [jnp.zeros(())] * 4
    low, end = list(zero), list(zero)
    low[AT_RUB], end[AT_RUB] = jnp.asarray(-2e-3), jnp.asarray(1e-3)
    low[AT_TURN], end[AT_TURN] = jnp.asarray(-1e-20), jnp.asarray(late)
    rates = [*zero]
    rates[AT_TURN] = jnp.asarray(rate)
    violated = {kind: jnp.asarray(kind in (AT_TURN, AT_RUB)) for kind in FOUR}
    nothing = Target(jnp.int32(0), *[jnp.zeros(())] * 3, tries=jnp.int32(0))
    low, end = (Guards(tuple(values), tuple(rates), tuple(zero)) for values in (low, end))
    (above, rise), crossed = first_crossed(low, end, violated, jnp.asarray(width), nothing)
    assert int(crossed.kind) == first
    assert_allclose(above / rise, max(1 / 3, late / rate / width), rtol=1e-12)


HAPPENINGS = [
    ("onset_slip", Mode.APART, 1, AT_LIFT, {"v": 0.0, "v_rate": 1.0, "u_rate": 2 * LAG}),
    ("onset_stick", Mode.APART, 1, AT_LIFT, {"v": 0.0, "v_rate": 1.0, "u_rate": 0.0}),
    ("separation", Mode.SLIP_PLUS, 2, AT_LIFT, {"v": 0.0}),
    ("separation", Mode.STICK, 3, AT_LIFT, {"v": 0.0}),
    ("stick_slip", Mode.STICK, 4, AT_RUB, {"w": 1.0}),
    ("slip_stick", Mode.SLIP_MINUS, 1, AT_RUB, {}),
    *((f"switch_{min(pair)}{max(pair)}", Mode.STICK, pair[0], kind, place) for kind, place, pair in SWITCHES),
]


@pytest.mark.parametrize(("name", "mode", "case", "kind", "place"), HAPPENINGS)
def test_every_event_is_counted_once_under_its_name(sides, ready, name, mode, case, kind, place):
    event, _ = crossed(inside(sides, mode, case, **place), kind, ready)
    yes, no = jnp.asarray(True), jnp.asarray(False)
    none = Counters(*[jnp.int32(0)] * len(Counters.__annotations__))
    once = {field: int(number) for field, number in vars(count_event(none, Ending(event, yes, no))).items() if number}
    assert once == {name: 1}
    assert not any(vars(count_event(none, Ending(event, no, yes))).values())  # not fired, not counted
    within = {
        field: int(number) for field, number in vars(count_event(none, Ending(event, yes, yes))).items() if number
    }
    assert within == {name: 1} | ({"grazing": 1} if name.startswith("onset") else {})
