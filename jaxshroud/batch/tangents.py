"""Tangents: the march together with its derivative along given directions, forward in time.

A tangent travels with its lane. Each lane has one direction, so that several directions of one scene are several lanes
with the same scene: what is batched over scenes is batched over directions too.
"""

from collections.abc import Sequence
from operator import attrgetter
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Int

from jaxshroud.batch.loop import driven
from jaxshroud.batch.periods import periods_at_once
from jaxshroud.batch.states import STATE, as_precise, by_blade, from_vector, inside, to_vector, whole
from jaxshroud.batch.threads import Check, in_chunks
from jaxshroud.batch.xla import DUAL_NUMBERS, EachLane, best, compiled, plain, repeated
from jaxshroud.march.events import seat
from jaxshroud.march.lane import Fixed, Lane, Lanes, begin, grid
from jaxshroud.march.locate import Search, select
from jaxshroud.march.method import Choices
from jaxshroud.march.step import End
from jaxshroud.march.stride import Leg
from jaxshroud.march.trial import Decision
from jaxshroud.model.absent import Pair, Scalar, filled, is_absent
from jaxshroud.model.friction import stretch
from jaxshroud.model.modes import FLAT, Mode, Status
from jaxshroud.model.ready import Model, model, turns
from jaxshroud.model.rhs import as_one
from jaxshroud.model.state import State
from jaxshroud.scene.keys import key_parts
from jaxshroud.scene.scene import Scene

WIDTHS = (16, 64)  # lanes per call, for few and for many: a loop of fewer does not pay for its dispatch


class Dual(NamedTuple):
    """A tree and its tangent: the same tree with None where nothing depends on the direction."""

    value: Any
    tangent: Any


def _moving(tree: Any) -> Any:
    """Which leaves of a tree have a tangent: every real number that later motion or power depends on."""
    return jax.tree.map(_moving_part, tree, is_leaf=lambda a: isinstance(a, Lane | End | Decision | Leg))


def _moving_part(part: Any) -> Any:
    fixed = jax.tree.map(lambda _: False, part)
    if isinstance(part, Decision):
        return fixed
    if isinstance(part, End):
        return fixed._replace(state=_real(part.state), Q=True, gain=True)
    if isinstance(part, Leg):
        return fixed._replace(motion=_real(part.motion), gain=_real(part.gain), length=True)
    if not isinstance(part, Lane):
        return jnp.issubdtype(part.dtype, jnp.floating)
    times = lambda search: (search.done, search.length) if isinstance(search, Search) else (search.done,)  # noqa: E731
    places = lambda lane: (lane.state, *times(lane.search), lane.tally.integrals.power)  # noqa: E731
    return eqx.tree_at(places, fixed, _real(places(part)))


def _real(tree: Any) -> Any:
    return jax.tree.map(lambda a: bool(jnp.issubdtype(a.dtype, jnp.floating)), tree)


def dual(each: EachLane) -> EachLane:
    """The way to run a function of one lane on `Dual`s of many; an argument that is none has no tangent."""

    def run(f, *args: Any) -> Dual:
        duals = [a if isinstance(a, Dual) else Dual(a, jax.tree.map(lambda _: None, a)) for a in args]
        if len(jax.tree.leaves(duals)) <= DUAL_NUMBERS:
            return each(lambda *duals: _pushed(f, duals), *duals)
        value = each(f, *(d.value for d in duals))
        return Dual(value, each(lambda *duals: _pushed(f, duals).tangent, *duals))

    return run


def _pushed(f, duals: tuple[Dual, ...]) -> Dual:
    """`f` and its derivative."""
    values, tangents = zip(*duals, strict=True)
    moving = jax.tree.map(lambda _, d: d is not None, values, tangents, is_leaf=lambda x: x is None)
    moves, rest = eqx.partition(values, moving)

    def of_moving(moves):
        out = f(*eqx.combine(moves, rest))
        return eqx.partition(out, _moving(out))

    out, out_tangent, out_rest = jax.jvp(of_moving, (moves,), (tangents,), has_aux=True)
    return Dual(eqx.combine(out, out_rest), out_tangent)


class Flow(NamedTuple):
    """What whole drive periods lead to."""

    state: State  # with its slider brought up to date; motion as pairs
    power: Pair  # mean square displacement over block and time [m^2]
    status: Int[Array, "..."]


def canonical(state: State, scene_model: Model) -> State:
    """The state with what its mode determines: the slider u - sigma mu N / k_d in slip, and 0 apart; one angle if flat.

    Numbers that no later motion depends on then agree, and have no tangent.
    """
    if turns(scene_model) and scene_model.spring.modal:
        angles = lambda motion: (motion.theta, motion.v_theta)  # noqa: E731
        level = [select(state.case == FLAT, as_one(pair, scene_model), pair) for pair in angles(state.motion)]
        state = eqx.tree_at(lambda s: angles(s.motion), state, tuple(level))
    at = seat(state.motion, state, scene_model)[2]
    if is_absent(state.u_s) or scene_model.spring.flows:
        return state
    u_s = at.u - stretch(at.v, at.u, state.u_s, state.mode, scene_model.spring)
    return eqx.tree_at(lambda s: s.u_s, state, jnp.where(state.mode == Mode.APART, 0.0, u_s))


def begun(scene: Scene, state: State, method: Choices) -> tuple[Lane, Model, Scalar]:
    """A lane about to start, its model and the drive's period."""
    scene_model = model(scene)
    lane = begin(canonical(inside(state, scene_model), scene_model), scene_model, method)
    return lane, scene_model, scene.drive.period


def ended(lane: Lane, scene_model: Model, time: Scalar) -> Flow:
    """What a lane has come to after `time` seconds."""
    left, right = filled(lane.tally.integrals.power, time)
    overflowed = (lane.status == Status.OK) & ~jnp.isfinite(left + right)
    status = jnp.where(overflowed, Status.NOT_FINITE, lane.status).astype(lane.status.dtype)
    return Flow(whole(canonical(lane.state, scene_model)), (left / time, right / time), status)


def whole_grid(models: Model, periods: Lanes, steps: Int[Array, " lanes"]) -> Fixed:
    """What stays the same for lanes that run one drive period of so many `steps` from phase 0."""
    count = steps.astype(periods.dtype)
    return Fixed(models, grid(jnp.zeros_like(count), count, periods), steps)


def dual_grid(models: Dual, periods: Dual, steps: Int[Array, " lanes"]) -> Dual:
    """The same with tangents."""
    fixed = whole_grid(models.value, periods.value, steps)
    count = steps.astype(periods.value.dtype)
    still = jax.tree.map(lambda _: None, fixed)
    along = still._replace(model=models.tangent, grid=still.grid._replace(h=periods.tangent / count))
    return Dual(fixed, along)


@compiled("method", "each")
def flow(scenes: Dual, states: Dual, n: Int[Array, ""], steps: Int[Array, ""], method: Choices, each: EachLane) -> Dual:
    """Run `n` drive periods from drive phase 0, with tangents.

    Args:
        scenes: Scenes with a leading lane axis, and one direction for each lane.
        states: Where to start, with the same axis, and one direction for each.
        n: Periods to run.
        steps: Runge-Kutta steps in one period.
        method: Static choices of the march, `differentiable`: else the derivatives lack what the events add.
        each: How a function of one lane is run on all.

    Returns:
        A `Flow` with leading lane axis and its tangent.
    """
    first = dual(plain)(lambda scene, state: begun(scene, state, method), scenes, states)
    lanes, models, periods = (Dual(a, b) for a, b in zip(*first, strict=True))
    fixed = dual_grid(models, periods, jnp.full_like(lanes.value.step, 1) * steps)
    one_period = lambda _, lanes: driven(lanes, fixed, steps, method, dual(each), attrgetter("value"))[0]  # noqa: E731
    lanes = lax.fori_loop(0, n, one_period, lanes)
    times = jax.tree.map(lambda a: n.astype(a.dtype) * a, periods)
    return dual(plain)(ended, lanes, models, times)


def differentiable(method: Choices) -> Choices:
    """The same method with derivatives of the events' instants, and nothing else that a flow does not need."""
    return method._replace(derivative=True, ledger=False, within=False, forces=False)


def run_flow(scenes: Dual, states: Dual, n: int, steps: int, method: Choices) -> Dual:
    """`flow` for any number of lanes, in chunks that share one compiled function; numpy arrays."""
    lanes = len(scenes.value.drive.omega)
    width = WIDTHS[lanes > WIDTHS[0] * 2]

    def run(check: Check, at: np.ndarray) -> Dual:
        scene, state = jax.tree.map(lambda a: np.asarray(a)[at], (scenes, states))
        return _in_parts(scene, state, n, steps, method, check)

    return in_chunks(run, lanes, width)


def _in_parts(scenes: Dual, states: Dual, n: int, steps: int, method: Choices, check: Check) -> Dual:
    """`flow`, in parts so short that an interruption need not wait for long."""
    longest = periods_at_once(len(scenes.value.drive.omega), steps, method)
    whole, done = None, 0
    while whole is None or done < n:
        check()
        now = min(longest, n - done)
        part = jax.tree.map(np.asarray, flow(scenes, states, jnp.int32(now), jnp.int32(steps), method, best()))
        whole = part if whole is None else _joined(whole, part, now / (done + now))
        states, done = onward(part), done + now
    return whole


def _joined(first: Dual, then: Dual, weight: float) -> Dual:
    """Two flows, one after the other; the second has `weight` of their time."""
    mean = lambda a, b: a + np.asarray(weight, a.dtype) * (b - a)  # noqa: E731
    power = jax.tree.map(mean, *([flow.power for flow in both] for both in (first, then)))
    status = np.where(first.value.status == Status.OK, then.value.status, first.value.status)
    return Dual(then.value._replace(power=power[0], status=status), then.tangent._replace(power=power[1]))


def resting(states: State) -> Dual:
    """States that do not depend on the direction."""
    motion, u_s = jax.tree.map(np.zeros_like, (states.motion, states.u_s))
    return Dual(states, State(motion, u_s, None, None))


def onward(end: Dual) -> Dual:
    """The states at the end of a flow, as a start."""
    (state, _, _), (tangent, _, _) = end
    moved = State(by_blade(tangent.motion), tangent.u_s, None, None)
    return Dual(State(by_blade(state.motion), state.u_s, state.mode, state.case), moved)


class Tangents(NamedTuple):
    """A scene's flow over some periods, and its derivatives with respect to the starting state and some parameters.

    A state is a vector of 13: x, y, theta and their rates, left blade before right, then the slider.
    """

    end: State
    vector: np.ndarray  # (13,) of `end`
    power: np.ndarray  # (2,) mean square displacement over block and time [m^2]
    status: int
    by_state: np.ndarray  # (13, 13) d vector / d start
    power_by_state: np.ndarray  # (2, 13)
    by_parameter: np.ndarray  # (13, parameters)
    power_by_parameter: np.ndarray  # (2, parameters)


class Course(NamedTuple):
    """One scene from a state, and what its flow is differentiated by."""

    scene: Scene
    state: State
    directions: Sequence[Scene] = ()  # derivative of the scene with respect to each parameter
    by_state: bool = True  # and by the starting state

    @property
    def by_start(self) -> int:
        """Directions in the state."""
        return STATE if self.by_state else 0

    @property
    def lanes(self) -> int:
        """Lanes, one for each direction; a single one where there are none."""
        return max(self.by_start + len(self.directions), 1)

    @property
    def duals(self) -> tuple[Dual, Dual]:
        """Scenes and states of its lanes."""
        lanes, state = self.lanes, as_precise(self.state, self.scene)
        still = [jax.tree.map(np.zeros_like, self.scene)] * (lanes - len(self.directions))
        along = jax.tree.map(lambda *a: np.stack(a), *still, *self.directions)
        unit = np.zeros((lanes, STATE), self.scene.drive.omega.dtype)
        unit[: self.by_start] = np.eye(STATE)[: self.by_start]
        shift = from_vector(unit, None, None)
        return Dual(repeated(self.scene, lanes), along), Dual(repeated(state, lanes), shift)

    def tangents(self, came: Dual) -> Tangents:
        """Tangents from the flow of its lanes."""
        (value, slope), end = came, jax.tree.map(lambda a: a[0], onward(came).value)
        by, count = to_vector(slope.state), self.by_start
        power, power_by = np.stack([a[0] for a in value.power]), np.stack(slope.power)
        parts = by[:count].T, power_by[:, :count], by[count:].T, power_by[:, count:]
        return Tangents(end, to_vector(end), power, int(value.status[0]), *parts)


def all_tangents(courses: Sequence[Course], *, n: int, steps: int, method: Choices) -> list[Tangents]:
    """Flow of each course over `n` periods from drive phase 0 with all its tangents, as one batch of lanes.

    Args:
        courses: Scenes of one structure, with their states and directions.
        n: Drive periods.
        steps: Runge-Kutta steps in one period.
        method: Static choices of the march, `differentiable`.
    """
    scenes, states = jax.tree.map(lambda *a: np.concatenate(a), *(course.duals for course in courses))
    came = run_flow(scenes, states, n, steps, method)
    ends = np.cumsum([course.lanes for course in courses])
    part = lambda end, lanes: jax.tree.map(lambda a: a[end - lanes : end], came)  # noqa: E731
    return [course.tangents(part(end, course.lanes)) for course, end in zip(courses, ends, strict=True)]


def tangents(
    scene: Scene,
    state: State,
    directions: Sequence[Scene],
    *,
    n: int,
    steps: int,
    method: Choices,
    by_state: bool = True,
) -> Tangents:
    """The same of one course."""
    (found,) = all_tangents([Course(scene, state, directions, by_state)], n=n, steps=steps, method=method)
    return found


def direction(scene: Scene, key: str) -> Scene:
    """Derivative of a scene with respect to one of its own numbers, or to one that both blades share."""
    table, name, blade = key_parts(key)
    place = lambda s: getattr(getattr(s, table), name)  # noqa: E731
    unit = np.ones_like(place(scene)) if blade is None else np.eye(2)[blade]
    return eqx.tree_at(place, jax.tree.map(np.zeros_like, scene), unit)
