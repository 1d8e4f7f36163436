"""Lyapunov exponents: the rates at which neighbouring motions separate, from tangents through every event.

Where there are no tangents, the largest exponent is given by how fast a nearby run parts from a run, as in G. Benettin
et al. (1980): after every drive period their logarithmic growth is noted, and the second run begins anew near the first
one. Sliders count as the motion does.
"""

from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import numpy as np

from jaxshroud.batch.duals import Dual
from jaxshroud.batch.flows import as_differentiable
from jaxshroud.batch.lanes import final_states, from_vector, to_vector
from jaxshroud.batch.plan import Plan, Tick
from jaxshroud.batch.tangents import TangentProblem, end_as_start, run_flow
from jaxshroud.march.method import Choices
from jaxshroud.model.linear_system import coordinates_that_move
from jaxshroud.model.modes import Mode, Status
from jaxshroud.model.prepared import State, law_type
from jaxshroud.orbits.batched_algorithms import Algorithm, Derivatives, Periods
from jaxshroud.orbits.orbit import free_sliders
from jaxshroud.scene.scene import Scene
from jaxshroud.signals.statistics import confidence_interval

MAX_ALIGNMENT_PERIODS = 64  # longest alignment of tangents after the transient
MIN_PAIR_ALIGNMENT = 16  # shortest alignment of two directions that keep growing unequally: they may still be turning
ALIGNMENT_TOLERANCE = 1e-4  # difference of the logarithmic growth per period at which two frames count as aligned
ALIGNMENT_PERIODS = 32  # periods in which a tangent turns into the fastest growing direction
RENORMALIZATION_PERIODS = 4  # periods between normalisations of the tangent
# A factor of a period below this share of the largest one is rounding: sums of products of Jacobians carry 1e-16 of
# their largest terms, and terms are larger than factors where directions turn.
LEAST_FACTOR = 1e-12


class Exponents(NamedTuple):
    """The exponents of one scene per drive period, as many as its state has numbers, the largest first."""

    exponents: np.ndarray  # (numbers,); -inf: forgotten altogether, NaN: not resolved, or the march has stopped
    ci: np.ndarray  # (numbers,) half width of the 95 % interval; NaN where there is none
    growth: np.ndarray  # (n, numbers) of each period
    stuck: bool  # whether the slider stays where it starts: an exponent of exactly 0
    status: int
    last: State


class StatePlaces(NamedTuple):
    """The places of the numbers that move among those of a scene's state."""

    motion: np.ndarray  # two of each coordinate in which a blade moves
    slider: np.ndarray  # one of each interface, of several points one of each, or none without friction

    @property
    def all(self) -> np.ndarray:
        """All of them."""
        return np.append(self.motion, self.slider)


def state_places(scene: Scene) -> StatePlaces:
    """The places of the numbers of the state of a scene."""
    moves = np.tile(coordinates_that_move(scene), 2)
    law = law_type(scene)
    if scene.laws is not None:
        rubs = scene.laws.has_friction
    else:
        rubs = law.has_stick or ((law.flows or law.has_points) and scene.parts.friction == "bilinear")
    return StatePlaces(np.flatnonzero(moves), len(moves) + np.arange(scene.sliders if rubs else 0))


def lyapunov_exponents(
    scene: Scene, state: State, n_periods: int, transient: int, steps: int, method: Choices
) -> Algorithm[Exponents]:
    """The exponents of the motion from a state, by QR factors of the product of the Jacobians of the periods.

    After the transient the tangents start in random directions; the average begins when two frames of them grow
    equally, or after 64 periods (where directions grow equally fast, no order emerges). The frames do not start
    earlier: along a transient they may take an order that differs from that of the settled motion, and keep it long.

    A slider that stays where it starts has an exponent of exactly 0, apart from those of the motion; the average begins
    anew once it moves. One that is set by the motion in some period (by an onset or by slip) has one of -inf. Faces of
    several points have a slider at each.
    """
    state = yield from state_after(scene, state, transient, steps, method)
    units = energy_units(scene)
    places = state_places(scene)
    stuck = np.ones(len(places.slider), bool)
    status = Status.OK
    frames = first_frames(len(places.motion))
    growth = []
    while len(growth) < n_periods:
        tangents = yield Derivatives(TangentProblem(scene, state), 1, steps, method)
        before = state
        state = tangents.end
        status = Status(tangents.status)
        if status != Status.OK:
            break
        begins_to_stick = (not frames.done) & _sliders_in(before, Mode.APART) & _sliders_in(state, Mode.STICK)
        stays = begins_to_stick | free_sliders(scene, tangents)
        if len(stuck) and not stays[stuck].all():
            stuck = stuck & stays
            frames = first_frames(len(places.all) - int(stuck.sum()))
            growth = []
        numbers = np.append(places.motion, places.slider[~stuck])
        frames, grown = next_frames(frames, (tangents.by_state * units / units[:, None])[np.ix_(numbers, numbers)])
        moving = len(stuck) - int(stuck.sum())
        if moving:
            forgotten = max(int(_are_sliders_set(scene, end)[~stuck].sum()) for end in (before, state))
            grown = [_without_forgotten(rates, forgotten, moving, scene.parts.contact == "spring") for rates in grown]
        growth += [np.append(rates, np.zeros(int(stuck.sum()))) for rates in grown]
    exponents, ci, growth = mean_exponents(np.array(growth).reshape(-1, len(places.all)))
    return Exponents(exponents, ci, growth, bool(stuck.any()), int(status), state)


def _sliders_in(state: State, mode: Mode) -> np.ndarray:
    """Which sliders are in a contact mode."""
    return np.ravel(state.mode) == mode


def _are_sliders_set(scene: Scene, state: State) -> np.ndarray:
    """Which sliders mode and motion determine: apart, or in slip, where user laws integrate their state."""
    slips = _sliders_in(state, Mode.SLIP_PLUS) | _sliders_in(state, Mode.SLIP_MINUS)
    return _sliders_in(state, Mode.APART) | (slips & (scene.parts.contact != "own"))


def _without_forgotten(rates: np.ndarray, forgotten: int, sliders: int, by_events: bool) -> np.ndarray:
    """The growth of a period (numbers,), -inf for sliders that are set by the motion at an end of it or within.

    The directions that vanish are the last of their frame, where rounding alone leaves a length: at least as many as
    are `forgotten` at an end of the period. Only sliders that move `by_events` vanish within a period; others follow
    the motion, however fast.
    """
    last = np.arange(len(rates) - sliders, len(rates))
    hidden = np.isnan(rates[last]) & by_events
    vanishes = hidden | (np.arange(sliders) >= sliders - forgotten)
    return np.append(rates[: len(rates) - sliders], np.where(vanishes, -np.inf, rates[last]))


class Frames(NamedTuple):
    """Two frames of directions that are propagated by a product of Jacobians."""

    pair: tuple[np.ndarray, ...]  # (size, size) each, orthonormal
    done: int  # number of Jacobians so far
    aligned: bool  # whether they have aligned with the directions of the motion


def first_frames(size: int) -> Frames:
    """Two random frames with as many directions as the state has numbers."""
    random = np.random.default_rng(0)
    return Frames(tuple(np.linalg.qr(random.standard_normal((size, size)))[0] for _ in range(2)), 0, False)


def next_frames(frames: Frames, M: np.ndarray) -> tuple[Frames, list[np.ndarray]]:
    """The frames after the next Jacobian of any map, and the logarithms of their growth: none until they are aligned.

    The average starts after the first period in which both frames grow equally. NaN: growth that rounding hides.
    """
    pair, factors = zip(*(np.linalg.qr(M @ f) for f in frames.pair), strict=True)
    with np.errstate(divide="ignore"):
        grown = np.log(np.abs([np.diag(R) for R in factors]))
    grown = np.where(grown < grown.max(axis=1, keepdims=True) + np.log(LEAST_FACTOR), np.nan, grown)
    done = frames.done + 1
    aligned = frames.aligned or done >= MAX_ALIGNMENT_PERIODS or _are_aligned(grown, done < MIN_PAIR_ALIGNMENT)
    return Frames(pair, done, aligned), [grown[0]] if frames.aligned else []


def mean_exponents(rates: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The exponents, largest first, the half widths of their intervals, and the growth in each period (n, size).

    -inf where a direction vanishes in some period, NaN where rounding hides its growth in some other, or where there is
    no period.
    """
    if not len(rates):
        nothing = np.full(rates.shape[1], np.nan)
        return nothing, nothing, rates
    with np.errstate(invalid="ignore"):
        mean = rates.mean(axis=0)
        ci = confidence_interval(rates.T)
    mean = np.where(np.isneginf(rates).any(axis=0), -np.inf, mean)
    order = np.argsort(-np.where(np.isnan(mean), np.finfo(float).min, mean), kind="stable")
    return mean[order], np.where(np.isfinite(mean), ci, np.nan)[order], rates[:, order]


def energy_units(scene: Scene) -> np.ndarray:
    """Displacements, rates and slider positions (..., numbers) of equal energy: tangents hardly oscillate in them."""
    b, modes = scene.running_blades, scene.mode_numbers
    stiffness, mass = (b.k_x, b.k_y, b.k_T), (b.m, b.inertia_y, b.I)
    if modes is not None:
        slow = np.asarray(scene.drive.omega)[..., None] ** 2  # in the place of 0, that of a rigid motion
        stiffness = [np.where(np.asarray(k) > 0, k, slow) for k in modes.stiffness]
        mass = np.ones_like(stiffness)
    soft = [1 / np.sqrt(np.asarray(a, float)) for a in (b.k_x, *stiffness, *mass)]
    sliders = np.repeat(soft[0][..., :1], scene.sliders, axis=-1)
    return np.concatenate([*soft[1:], sliders], axis=-1)


def _are_aligned(grown: np.ndarray, each: bool) -> bool:
    """Whether two frames span the same directions: each, or two neighbours that rotate into each other as one."""
    with np.errstate(invalid="ignore"):
        volumes = np.cumsum(np.where(np.isfinite(grown), grown, 0.0), axis=1)
    differs = np.abs(volumes[0] - volumes[1]) > ALIGNMENT_TOLERANCE
    return not np.any(differs if each else differs[1:] & differs[:-1])


def state_after(scene: Scene, state: State, transient: int, steps: int, method: Choices) -> Algorithm[State]:
    """The state `transient` periods later."""
    if transient == 0:
        return state
    runs = yield Periods(scene, state, Plan(transient - 1, 1, steps, 0.0, method))
    return jax.tree.map(lambda a: a[0], final_states(runs.last.state))


class LargestExponents(NamedTuple):
    """The largest exponents of lanes per drive period."""

    exponent: np.ndarray  # (lanes,); -inf where every perturbation vanishes; NaN once a lane has stopped
    ci: np.ndarray  # (lanes,) half width of the 95 % interval
    growth: np.ndarray  # (lanes, blocks) of each block of periods, per period
    status: np.ndarray  # (lanes,)
    last: State


def with_phase_shift(scenes: Scene, phase: float) -> Scene:
    """The scenes with their drives advanced by the `phase` [rad]."""
    return eqx.tree_at(lambda s: s.drive, scenes, scenes.drive.advanced(phase)) if phase else scenes


def largest_exponents(
    scenes: Scene,
    states: State,
    n: int,
    steps: int,
    method: Choices,
    ticker: Tick = lambda _: None,
    numbers: np.ndarray | None = None,
) -> LargestExponents:
    """The largest exponent of settled motions from their states at drive phase 0.

    It is the average over `n` periods, a multiple of 4, after 32 periods in which the tangents align. A tangent begins
    in a random direction without a component of the slider: a slider in permanent stick stays where it starts, with an
    exponent of 0 that is not one of the motion. Each lane has its own direction, by the `numbers` of the lanes (lanes,)
    where only some of them are run.
    """
    lanes = len(scenes.drive.omega)
    unit = energy_units(scenes)
    numbers = np.arange(lanes) if numbers is None else numbers
    tangents = np.random.default_rng(0).standard_normal((numbers.max() + 1, scenes.state_size))[numbers] * unit
    tangents[:, -scenes.sliders :] = 0.0
    no_change = jax.tree.map(np.zeros_like, scenes)
    method = as_differentiable(method)
    alignment_blocks = ALIGNMENT_PERIODS // RENORMALIZATION_PERIODS
    blocks = max(round(n / RENORMALIZATION_PERIODS), 1)
    growth = np.empty((lanes, alignment_blocks + blocks))
    status = np.full(lanes, Status.OK, np.int32)
    for i in range(alignment_blocks + blocks):
        with np.errstate(divide="ignore", invalid="ignore"):
            tangents = tangents / np.linalg.norm(tangents / unit, axis=1, keepdims=True)
        tangents = np.where(np.isfinite(tangents), tangents, 0.0).astype(scenes.drive.omega.dtype)
        flows = run_flow(
            Dual(scenes, no_change),
            Dual(states, from_vector(tangents, None, None, scenes)),
            RENORMALIZATION_PERIODS,
            steps,
            method,
        )
        status = np.where(status == Status.OK, flows.value.status, status)
        states = end_as_start(flows).value
        tangents = to_vector(flows.tangent.own)
        with np.errstate(divide="ignore", invalid="ignore"):
            grown = np.log(np.linalg.norm(tangents / unit, axis=1)) / RENORMALIZATION_PERIODS
        growth[:, i] = np.where(status == Status.OK, grown, np.nan)
        ticker(lanes * RENORMALIZATION_PERIODS)
    growth = growth[:, alignment_blocks:]
    with np.errstate(invalid="ignore"):
        return LargestExponents(growth.mean(axis=1), confidence_interval(growth), growth, status, states)


NEARBY = 1e-7  # distance of the two runs at the start of each period, in sizes of the motion
ALIGNED = 8  # periods that turn the difference into the direction that grows most
SEED = 0  # of the first direction
LEAST_DISTANCE = 1e-14  # in sizes of the motion: what is left of a smaller distance is rounding


class NearbyGrowth(NamedTuple):
    """The growth of the distance of a nearby run."""

    exponent: float  # per drive period; NaN where a run stopped, or rounding hides what is left of the distance
    ci: float  # half width of its 95 % interval
    periods: int  # over which it is averaged


def nearby_growth(
    scene: Scene, states: State, size: np.ndarray, period_of: Callable[[State], tuple[State, bool]], periods: int
) -> NearbyGrowth:
    """The growth over so many periods.

    Args:
        scene: The scene.
        states: The state of one lane (leading axis) at drive phase 0.
        size: Of each number of a state (numbers,), for its distance; 0 of those that do not move.
        period_of: The state after a period, and whether the run goes on.
        periods: Drive periods, after those for alignment.
    """
    motion = scene.state_size - scene.sliders
    drawn = np.append(np.random.default_rng(SEED).standard_normal(motion), np.zeros(scene.sliders))
    here = states
    there = _moved_by(scene, here, drawn * size, size)
    growth = []
    for _ in range(ALIGNED + periods):
        (here, goes), (there, also) = period_of(here), period_of(there)
        if not (goes and also):
            return NearbyGrowth(np.nan, np.nan, 0)
        difference = _difference(here, there)
        distance = _sized_distance(difference, size)
        growth.append(np.log(distance / NEARBY) if distance > LEAST_DISTANCE else np.nan)
        there = _moved_by(scene, here, difference, size)
    kept = np.array(growth[ALIGNED:])
    return NearbyGrowth(float(kept.mean()), float(confidence_interval(kept[None])[0]), periods)


def _difference(here: State, there: State) -> np.ndarray:
    """The difference of two states as a vector; of sliders where both stick or slip alike."""
    case, mode = np.asarray(here.case) == there.case, np.asarray(here.mode) == there.mode
    alike = mode & (case if case.ndim == mode.ndim else case[..., None])  # of several points each
    u_s = np.where(alike, there.u_s, here.u_s)
    return to_vector(State(there.motion, u_s, there.mode, there.case)) - to_vector(here)


def _sized_distance(difference: np.ndarray, size: np.ndarray) -> float:
    """The distance in sizes of the motion."""
    return float(np.linalg.norm(difference / np.where(size > 0, size, np.inf)))


def _moved_by(scene: Scene, state: State, difference: np.ndarray, size: np.ndarray) -> State:
    """A state moved by `NEARBY` in the direction of a difference."""
    share = NEARBY / max(_sized_distance(difference, size), np.finfo(float).tiny)
    return from_vector(to_vector(state) + share * difference, state.mode, state.case, scene)
