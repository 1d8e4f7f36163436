"""The motions that lanes of one scene end on, told apart by the distance between their orbits."""

from typing import NamedTuple

import jax
import numpy as np

from jaxshroud.batch.runs import Plan, Tick, run_lanes
from jaxshroud.batch.states import STATE, final_states, from_vector, rows, to_vector
from jaxshroud.batch.xla import repeated
from jaxshroud.model.modes import Status
from jaxshroud.model.state import State
from jaxshroud.motion.apart import Floats, alike, distance, home, to_nearest
from jaxshroud.motion.averages import averages, sizes_of
from jaxshroud.motion.orbit import Cycle
from jaxshroud.motion.settling import LARGEST_PERIOD, YES
from jaxshroud.motion.shooting import Aim, closed_orbit, moved_start, shortest_orbit, state_sizes
from jaxshroud.motion.together import Algorithm, alone_found
from jaxshroud.scene.scene import Scene

KEPT, KEPT_APERIODIC = 64, 512  # periods that are looked at
FIRST = 192  # periods of the first round, whatever the motion; each round doubles them
EXACT, EXPLAINED = 1e-6, 4.0  # distances that are none, and times a lane's own drift that may still be gone
NEARBY = 0.05  # of the motion's size: no lane further away is still on its way to an orbit
ALONG = 0.05  # share of a move that the slider must leave unexplained for two orbits to be of two families
STRIDES = 8  # in which a slider is moved from one orbit to another
LONG = 128  # aperiodic lanes that are run on
MOST = 64  # motions that are told apart


class Ended(NamedTuple):
    """Where lanes have come to (leading axis), and what they did in their latest periods."""

    state: State
    status: np.ndarray
    number: np.ndarray  # period number, 0: aperiodic or not settled
    samples: np.ndarray  # (lanes, KEPT, 12) at the strobe
    sizes: np.ndarray  # (lanes, 6) largest magnitudes of displacements
    P_d: np.ndarray  # [%]
    ci: np.ndarray  # half width of its 95 % interval


class Attractor(NamedTuple):
    """A motion that lanes end on."""

    kind: str  # "periodic", "family", "aperiodic"
    q: int  # period number; 0: aperiodic
    lanes: np.ndarray  # those that end there
    points: Floats  # (n, 12) of its orbit at the strobe, in units of `Found.units`
    cycle: Cycle | None  # of a periodic one
    state: State  # on it, at drive phase 0


class Found(NamedTuple):
    """What lanes end on."""

    attractors: list[Attractor]
    label: np.ndarray  # place among these of each lane; -1: undecided, -2: stopped
    ended: Ended
    units: np.ndarray  # (12,) sizes of displacements and rates
    gap: float  # of the scene [m]


def ended(scene: Scene, states: State, most: int, steps: int, method, ticker: Tick) -> Ended:
    """Lanes run from their states until they repeat and are settled, for `most` periods at most."""
    found = _round(scene, states, Plan(max(min(FIRST, most) - KEPT, 0), KEPT, steps, 0.0, method), ticker)
    spent = max(FIRST, KEPT)
    while spent < most:
        pending = np.flatnonzero((found.number == 0) & (found.status == Status.OK))
        if not len(pending):
            break
        plan = Plan(min(spent, most - spent) - KEPT, KEPT, steps, 0.0, method)
        if plan.transient < 0:
            break
        spent += plan.transient + KEPT
        state = jax.tree.map(lambda a: a[pending], found.state)  # noqa: B023  called at once
        found = _put(found, pending, _round(scene, state, plan, ticker))
    return found


def _round(scene: Scene, states: State, plan: Plan, ticker: Tick) -> Ended:
    scenes = repeated(scene, len(states.u_s))
    runs = run_lanes(scenes, states, plan, ticker)
    orbit, power, _ = averages(scenes, runs.samples)
    status, sizes = np.asarray(runs.last.status), sizes_of(runs.samples).max(axis=1)
    number = np.where((orbit.settling.verdict == YES) & (status == Status.OK), orbit.number, 0)
    return Ended(final_states(runs.last.state), status, number, rows(runs.samples.motion), sizes, power.P_d, power.ci)


def _put(found: Ended, at: np.ndarray, new: Ended) -> Ended:
    """`found` with the lanes `at` replaced."""

    def put(old, latest):
        copy = np.array(old)
        copy[at] = latest
        return copy

    return jax.tree.map(put, found, new)


def attractors_of(scene: Scene, states: State, most: int, aim: Aim, ticker: Tick) -> Found:
    """What lanes of a scene end on from their states (leading axis)."""
    end = ended(scene, states, most, aim.steps, aim.method, ticker)
    good = end.status == Status.OK
    units = _units(scene, end.sizes[good] if good.any() else np.ones((1, 6)))
    label = np.where(good, -1, -2)
    periodic, label = _orbits(scene, end, label, units, aim)
    periodic, label = _families(periodic, label, aim)
    aperiodic, label = _sets(scene, end, label, len(periodic), units, aim, ticker)
    order = np.argsort([-len(one.lanes) for one in (*periodic, *aperiodic)], kind="stable")
    place = np.append(np.argsort(order), [-2, -1])  # so that -1 and -2 stay
    return Found([(*periodic, *aperiodic)[i] for i in order], place[label], end, units, float(scene.shroud.gap))


def _units(scene: Scene, sizes: np.ndarray) -> np.ndarray:
    """In what displacements and rates (12,) are measured: the largest of all lanes, and these times omega."""
    place = np.repeat(sizes.max(axis=0).reshape(3, 2).max(axis=1), 2)
    place = np.where(place > 0, place, 1.0)
    return np.concatenate([place, place * float(scene.drive.omega)])


def _orbits(scene: Scene, end: Ended, label: np.ndarray, units: np.ndarray, aim: Aim):
    """Periodic attractors: one lane after the other is closed, and all that end on its orbit go with it."""
    found: list[Attractor] = []
    label, left = label.copy(), np.flatnonzero(end.number)
    while len(left) and len(found) < MOST:
        leader = int(left[0])
        cycle = alone_found(_stable_orbit(scene, _lane(end.state, leader), int(end.number[leader]), aim))
        if cycle is None:
            left = left[1:]
            continue
        points = _points(cycle, aim) / units
        on = np.array([lane for lane in left.tolist() if lane == leader or _ends_on(cycle, points, end, lane, units)])
        left = np.setdiff1d(left, on)
        known = next((i for i, one in enumerate(found) if distance(one.points, points) <= EXACT), None)
        label[on] = len(found) if known is None else known
        if known is None:
            kind = "family" if cycle.slider_is_free else "periodic"
            found.append(Attractor(kind, cycle.q, on, points, cycle, cycle.start))
        else:
            found[known] = found[known]._replace(lanes=np.append(found[known].lanes, on))
    return found, label


def _lane(state: State, lane: int) -> State:
    return jax.tree.map(lambda a: np.asarray(a)[lane], state)


def _stable_orbit(scene: Scene, state: State, q: int, aim: Aim) -> Algorithm[Cycle | None]:
    """The stable orbit beside a settled lane; next to a flip its period may be twice what it seems."""
    for number in (q, 2 * q):
        cycle = yield from closed_orbit(scene, state, number, aim)
        if cycle.sound and number <= 2 * LARGEST_PERIOD:
            return (yield from shortest_orbit(cycle, state_sizes(scene, cycle.start), aim))
    return None


def _points(cycle: Cycle, aim: Aim) -> np.ndarray:
    """The orbit at the strobe, (q, 12)."""
    plan = Plan(0, cycle.q, aim.steps, 0.0, aim.method)
    states = jax.tree.map(lambda a: np.asarray(a)[None], cycle.start)
    return rows(run_lanes(repeated(cycle.scene, 1), states, plan, lambda _: None).samples.motion)[0]


def _ends_on(cycle: Cycle, points: Floats, end: Ended, lane: int, units: np.ndarray) -> bool:
    """Whether a lane is on an orbit, but for what its own drift shows is still to go.

    What drifts by r in a period of the orbit at the rate of its largest multiplier has r / (1 - |multiplier|) to go.
    """
    q, samples = int(end.number[lane]), end.samples[lane] / units
    if cycle.slider_is_free and end.state.mode[lane] == cycle.start.mode:
        return _beside(cycle, samples[-q:], float(end.state.u_s[lane]), units)
    if cycle.q % q and q % cycle.q:  # a slow lane may still look like a multiple
        return False
    drift = float(np.abs(samples[-q:] - samples[-2 * q : -q]).max())
    most = min(max(EXACT, EXPLAINED * drift / max(1 - abs(cycle.others[0]), 1e-3)), NEARBY)
    return distance(samples[-max(q, cycle.q) :], points) <= most


def _beside(cycle: Cycle, samples: Floats, u_s: float, units: np.ndarray) -> bool:
    """Whether samples (n, 12) are of an orbit that differs from a free slider's by the slider's place alone."""
    assert cycle.jacobian is not None  # there is an orbit
    z, shift = to_vector(cycle.start), u_s - float(cycle.start.u_s)
    by_slider = moved_start(cycle.jacobian.by_state, cycle.jacobian.by_state[:, -1:], True)[:-1, 0]
    off = np.abs(samples - (z[:-1] + by_slider * shift) / units).max(axis=1)
    whole = np.abs(samples - z[:-1] / units).max(axis=1)
    return bool(np.any(off <= np.maximum(ALONG * whole, 1e-3)))


def _families(found: list[Attractor], label: np.ndarray, aim: Aim):
    """The attractors, those that differ by the place of a free slider alone joined to one."""
    kept: list[Attractor] = []
    place = np.arange(len(found) + 2)
    for i, one in enumerate(found):
        same = next(
            (j for j, other in enumerate(kept) if one.kind == other.kind == "family" and _joined(other, one, aim)), None
        )
        if same is None:
            place[i] = len(kept)
            kept.append(one)
        else:
            place[i] = same
            kept[same] = kept[same]._replace(lanes=np.append(kept[same].lanes, one.lanes))
    place[-2:] = -2, -1
    return kept, place[label]


def _joined(a: Attractor, b: Attractor, aim: Aim) -> bool:
    """Whether moving the slider leads from one orbit to the other."""
    if a.q != b.q or a.cycle is None or b.cycle is None:
        return False
    reached = alone_found(_with_slider(a.cycle, float(b.cycle.start.u_s), aim))
    if reached is None:
        return False
    sizes = state_sizes(b.cycle.scene, b.cycle.start)
    return bool(np.all(np.abs(to_vector(reached.start) - to_vector(b.cycle.start)) <= 1e3 * EXACT * sizes))


def _with_slider(cycle: Cycle, u_s: float, aim: Aim) -> Algorithm[Cycle | None]:
    """The orbit with its free slider moved, stride by stride."""
    here, begin = cycle, float(cycle.start.u_s)
    for stride in range(1, STRIDES + 1):
        z = to_vector(here.start)
        z[STATE - 1] = begin + (u_s - begin) * stride / STRIDES
        state = from_vector(z, here.start.mode, here.start.case)
        here = yield from closed_orbit(here.scene, state, cycle.q, aim)
        if "not converged" in here.flags or not here.slider_is_free:
            return None
    return here


def _sets(scene: Scene, end: Ended, label: np.ndarray, first: int, units: np.ndarray, aim: Aim, ticker: Tick):
    """Aperiodic attractors, by the sets that longer runs of some lanes fill; the others are where their points are."""
    lanes = np.flatnonzero((end.number == 0) & (end.status == Status.OK))
    if not len(lanes):
        return [], label
    some, rest, label = lanes[:LONG], lanes[LONG:], label.copy()
    state = jax.tree.map(lambda a: np.asarray(a)[some], end.state)
    runs = run_lanes(repeated(scene, len(some)), state, Plan(0, KEPT_APERIODIC, aim.steps, 0.0, aim.method), ticker)
    points, states = rows(runs.samples.motion) / units, final_states(runs.last.state)
    good = np.asarray(runs.last.status) == Status.OK
    label[some[~good]] = -2
    sets = _told_apart(points, np.flatnonzero(good))[: max(MOST - first, 0)]
    found = [Attractor("aperiodic", 0, some[on], points[on[0]], None, _lane(states, int(on[0]))) for on in sets]
    for i, on in enumerate(sets):
        label[some[on]] = first + i
    for lane in rest:
        place = home([one.points for one in found], end.samples[lane] / units)
        if place is not None:
            label[lane] = first + place
    return [one._replace(lanes=np.flatnonzero(label == first + i)) for i, one in enumerate(found)], label


def _told_apart(points: Floats, left: np.ndarray) -> list[np.ndarray]:
    """Lanes of each set; one that is like none for sure, and not unlike all for sure, is in none."""
    found = []
    while len(left):
        told = {i: alike(points[left[0]], points[i]) for i in left[1:]}
        on = np.array([left[0], *(i for i, same in told.items() if same)])
        if len(on) > 1 or None not in told.values():
            found.append(on)
        left = np.setdiff1d(left, on)
    return found


def nearest(attractors: list[Attractor]) -> np.ndarray:
    """Distance of each attractor from the nearest other one, in sizes of the motion; inf where it is alone."""
    apart = [
        min((to_nearest(one.points, other.points) for other in attractors if other is not one), default=np.inf)
        for one in attractors
    ]
    return np.array(apart, float)
