"""The attractors of one scene on which lanes end, distinguished by the distance between their orbits."""

from typing import NamedTuple

import jax
import numpy as np

from jaxshroud.batch.lanes import from_vector, motion_rows, shroud_rows, to_vector
from jaxshroud.batch.plan import Plan, Tick
from jaxshroud.batch.runs import run_lanes
from jaxshroud.batch.xla import repeat_lane
from jaxshroud.model.modes import Status
from jaxshroud.model.prepared import State
from jaxshroud.orbits.batched_algorithms import Algorithm, run_alone, stacked
from jaxshroud.orbits.orbit import PeriodicOrbit
from jaxshroud.orbits.shooting import ShootingOptions, closed_orbit, moved_start, shortest_orbit, state_scales
from jaxshroud.orbits.starts import LaneEnds, lane_ends, replace_lanes, run_until_settled, take_lanes
from jaxshroud.orbits.verdict import VERDICT_ROUNDS, verdicts
from jaxshroud.orbits.verdict_evidence import Stretches
from jaxshroud.scene.scene import Scene
from jaxshroud.scene.typed import FloatArray
from jaxshroud.signals.orbit_distance import containing_set, fill_one_set, mean_nearest_distance, set_distance
from jaxshroud.signals.period import LARGEST_PERIOD

KEPT_APERIODIC_PERIODS = 512  # latest periods of an aperiodic lane, which are compared
# distance of equal orbits, and multiple of the drift that a lane may still have to go
SAME_ORBIT_DISTANCE, DRIFT_FACTOR = 1e-6, 4.0
MAX_DRIFT_DISTANCE = 0.05  # of the motion's size: no lane further away is approaching an orbit
SLIDER_SHARE = 0.05  # largest share of a difference that the slider leaves unexplained within one family
SLIDER_MOVES = 8  # steps in which a slider is moved from one orbit to another
MAX_LONG_RUNS = 128  # aperiodic lanes that are continued
MAX_ATTRACTORS = 64  # attractors that are distinguished
VERDICT_PERIODS = (2**VERDICT_ROUNDS - 1) * Stretches().all  # longest run of a verdict
LASTING_KINDS = ("chaotic", "quasi-periodic")  # verdicts on aperiodic motions that last


class Attractor(NamedTuple):
    """A motion on which lanes end."""

    kind: str  # "periodic", "family", "aperiodic"
    q: int  # period number; 0: aperiodic
    lanes: np.ndarray  # the lanes that end on it
    points: FloatArray  # (n, 6 blades) of its orbit at the strobe, in `FoundAttractors.units`
    cycle: PeriodicOrbit | None  # None unless it is periodic
    state: State  # a state on it at drive phase 0


class FoundAttractors(NamedTuple):
    """The attractors of lanes."""

    attractors: list[Attractor]
    label: np.ndarray  # index of the attractor of each lane; -1: undecided, -2: stopped
    ended: LaneEnds
    units: np.ndarray  # (6 blades,) sizes of displacements and rates
    scene: Scene


def attractors_of(scene: Scene, states: State, max_periods: int, aim: ShootingOptions, ticker: Tick) -> FoundAttractors:
    """The attractors on which lanes of a scene end from their states (leading axis)."""
    end = run_until_settled(scene, states, max_periods, aim.steps, aim.method, ticker)
    is_ok = end.status == Status.OK
    units = _motion_scales(scene, end.sizes[is_ok] if is_ok.any() else np.ones_like(end.sizes[:1]))
    end, aperiodic = _aperiodic_attractors(scene, end, units, aim, ticker)
    label = np.where(end.status == Status.OK, -1, -2)
    periodic, label = _periodic_attractors(scene, end, label, units, aim)
    periodic, label = _joined_families(periodic, label, aim)
    for i, attractor in enumerate(aperiodic, len(periodic)):
        label[attractor.lanes] = i
    attractors = [*periodic, *aperiodic]
    order = sorted(range(len(attractors)), key=lambda i: _place_in_order(attractors[i], end))
    rank = np.append(np.argsort(order), [-2, -1])  # so that -1 and -2 stay
    return FoundAttractors([attractors[i] for i in order], rank[label], end, units, scene)


def _place_in_order(attractor: Attractor, end: LaneEnds) -> tuple[int | float, str, float, float]:
    """What attractors are sorted by, properties of the motion whatever the starts: period, kind, P_d from the largest.

    Copies of a motion in a ring, whose P_d differ by rounding, follow the largest x of the first blade at the strobe.
    Aperiodic motions, whose P_d is known to the accuracy of an average only, come last.
    """
    P_d = np.mean(end.P_d[attractor.lanes]) if attractor.cycle is None else attractor.cycle.P_d
    return attractor.q or np.inf, attractor.kind, -round(float(P_d), 6), -float(attractor.points[:, 0].max())


def _motion_scales(scene: Scene, sizes: np.ndarray) -> np.ndarray:
    """The units of displacements and rates (6 blades,): the largest displacements of all, and these times omega."""
    blades = scene.layout.blades
    place = np.repeat(sizes.max(axis=0).reshape(3, blades).max(axis=1), blades)
    place = np.where(place > 0, place, 1.0)
    return np.concatenate([place, place * float(scene.drive.omega)])


def _periodic_attractors(scene: Scene, end: LaneEnds, label: np.ndarray, units: np.ndarray, aim: ShootingOptions):
    """The periodic attractors: the orbits of one lane after another, each with all lanes that end on it."""
    attractors: list[Attractor] = []
    label = label.copy()
    unassigned = np.flatnonzero(end.number)
    while len(unassigned) and len(attractors) < MAX_ATTRACTORS:
        leader = int(unassigned[0])
        cycle = run_alone(_stable_orbit(scene, _take_lane(end.state, leader), int(end.number[leader]), aim))
        if cycle is None:
            unassigned = unassigned[1:]
            continue
        points = _orbit_points(cycle, aim) / units
        members = np.array(
            [lane for lane in unassigned.tolist() if lane == leader or _ends_on(cycle, points, end, lane, units)]
        )
        unassigned = np.setdiff1d(unassigned, members)
        same = next(
            (
                i
                for i, attractor in enumerate(attractors)
                if set_distance(attractor.points, points) <= SAME_ORBIT_DISTANCE
            ),
            None,
        )
        label[members] = len(attractors) if same is None else same
        if same is None:
            kind = "family" if cycle.slider_is_free else "periodic"
            attractors.append(Attractor(kind, cycle.q, members, points, cycle, cycle.start))
        else:
            attractors[same] = attractors[same]._replace(lanes=np.append(attractors[same].lanes, members))
    return attractors, label


def _take_lane(state: State, lane: int) -> State:
    return jax.tree.map(lambda a: np.asarray(a)[lane], state)


def _stable_orbit(scene: Scene, state: State, q: int, aim: ShootingOptions) -> Algorithm[PeriodicOrbit | None]:
    """The stable orbit near a settled lane; close to a flip its period may be twice the apparent one."""
    for number in (q, 2 * q):
        cycle = yield from closed_orbit(scene, state, number, aim)
        if cycle.sound and number <= 2 * LARGEST_PERIOD:
            return (yield from shortest_orbit(cycle, state_scales(scene, cycle.start), aim))
    return None


def _orbit_points(cycle: PeriodicOrbit, aim: ShootingOptions) -> np.ndarray:
    """The orbit at the strobe, (q, 6 blades)."""
    plan = Plan(0, cycle.q, aim.steps, 0.0, aim.method)
    states = jax.tree.map(lambda a: np.asarray(a)[None], cycle.start)
    return motion_rows(run_lanes(repeat_lane(cycle.scene, 1), states, plan, lambda _: None).samples.motion)[0]


def _ends_on(cycle: PeriodicOrbit, points: FloatArray, end: LaneEnds, lane: int, units: np.ndarray) -> bool:
    """Whether a lane is on an orbit, up to the distance that its drift shows is still to go.

    A lane that drifts by r in a period of the orbit, at the rate of its largest multiplier, has r / (1 - |multiplier|)
    to go.
    """
    q = int(end.number[lane])
    samples = end.samples[lane] / units
    if cycle.slider_is_free and np.array_equal(end.state.mode[lane], cycle.start.mode):
        return _differs_by_slider(cycle, samples[-q:], _free_places(cycle, end.state.u_s[lane]), units)
    if cycle.q % q and q % cycle.q:  # a slow lane may still seem to have a multiple of the period
        return False
    drift = float(np.abs(samples[-q:] - samples[-2 * q : -q]).max())
    limit = min(
        max(SAME_ORBIT_DISTANCE, DRIFT_FACTOR * drift / max(1 - abs(cycle.others[0]), 1e-3)), MAX_DRIFT_DISTANCE
    )
    return bool(set_distance(samples[-max(q, cycle.q) :], points) <= limit)


def _free_places(cycle: PeriodicOrbit, u_s: np.ndarray) -> np.ndarray:
    """The positions of those sliders that are free on an orbit [m]."""
    return np.ravel(u_s)[cycle.free_sliders]


def _differs_by_slider(cycle: PeriodicOrbit, samples: FloatArray, u_s: np.ndarray, units: np.ndarray) -> bool:
    """Whether samples (n, 6 blades) are of an orbit that differs by the positions of free sliders only."""
    assert cycle.jacobian is not None  # there is an orbit
    z = to_vector(cycle.start)
    shift = u_s - _free_places(cycle, cycle.start.u_s)
    free = cycle.free_sliders
    M = cycle.jacobian.by_state
    by_sliders = moved_start(M, M[:, len(M) - len(free) :][:, free], free)
    here, there = shroud_rows(np.stack([z, z + by_sliders @ shift]), cycle.scene)
    unexplained = np.abs(samples - there / units).max(axis=1)
    difference = np.abs(samples - here / units).max(axis=1)
    return bool(np.any(unexplained <= np.maximum(SLIDER_SHARE * difference, 1e-3)))


def _joined_families(attractors: list[Attractor], label: np.ndarray, aim: ShootingOptions):
    """The attractors, with those that differ by the position of a free slider only joined into families."""
    joined: list[Attractor] = []
    index = np.arange(len(attractors) + 2)
    for i, attractor in enumerate(attractors):
        same = next(
            (
                j
                for j, other in enumerate(joined)
                if attractor.kind == other.kind == "family" and _is_same_family(other, attractor, aim)
            ),
            None,
        )
        if same is None:
            index[i] = len(joined)
            joined.append(attractor)
        else:
            index[i] = same
            joined[same] = joined[same]._replace(lanes=np.append(joined[same].lanes, attractor.lanes))
    index[-2:] = -2, -1
    return joined, index[label]


def _is_same_family(a: Attractor, b: Attractor, aim: ShootingOptions) -> bool:
    """Whether moving the sliders leads from one orbit to the other."""
    if a.q != b.q or a.cycle is None or b.cycle is None:
        return False
    orbit = run_alone(_with_sliders(a.cycle, _free_places(a.cycle, b.cycle.start.u_s), aim))
    if orbit is None:
        return False
    sizes = state_scales(b.cycle.scene, b.cycle.start)
    return bool(np.all(np.abs(to_vector(orbit.start) - to_vector(b.cycle.start)) <= 1e3 * SAME_ORBIT_DISTANCE * sizes))


def _with_sliders(cycle: PeriodicOrbit, u_s: np.ndarray, aim: ShootingOptions) -> Algorithm[PeriodicOrbit | None]:
    """The orbit with its free sliders moved step by step."""
    orbit = cycle
    begin = _free_places(cycle, cycle.start.u_s)
    places = cycle.scene.state_size - len(cycle.free_sliders) + np.flatnonzero(cycle.free_sliders)
    for stride in range(1, SLIDER_MOVES + 1):
        z = to_vector(orbit.start)
        z[places] = begin + (u_s - begin) * stride / SLIDER_MOVES
        state = from_vector(z, orbit.start.mode, orbit.start.case, cycle.scene)
        orbit = yield from closed_orbit(orbit.scene, state, cycle.q, aim)
        if "not converged" in orbit.flags or not orbit.slider_is_free:
            return None
    return orbit


def _aperiodic_attractors(
    scene: Scene, end: LaneEnds, units: np.ndarray, aim: ShootingOptions, ticker: Tick
) -> tuple[LaneEnds, list[Attractor]]:
    """The lane ends once apparently aperiodic lanes have been continued, and the aperiodic attractors.

    These are the sets that longer runs of some lanes fill; the other lanes belong to the set that contains their
    points. Lanes that are in none, or in a set that does not last, are continued until they settle, for as long as a
    verdict takes at most.
    """
    lanes = _aperiodic_lanes(end)
    if not len(lanes):
        return end, []
    long_runs, rest = lanes[:MAX_LONG_RUNS], lanes[MAX_LONG_RUNS:]
    scenes = repeat_lane(scene, len(long_runs))
    states = take_lanes(end.state, long_runs)
    runs = run_lanes(scenes, states, Plan(0, KEPT_APERIODIC_PERIODS, aim.steps, 0.0, aim.method), ticker)
    later_ends = lane_ends(scenes, runs)
    points = motion_rows(runs.samples.motion) / units
    sets = _lasting_sets(
        scene, later_ends.state, _distinct_sets(points, _aperiodic_lanes(later_ends))[:MAX_ATTRACTORS], aim
    )
    end = _with_settled_lanes(end, long_runs, later_ends)
    containing = [containing_set([points[group[0]] for group in sets], end.samples[lane] / units) for lane in rest]
    members = [np.append(long_runs[group], rest[[place == i for place in containing]]) for i, group in enumerate(sets)]
    attractors = [
        Attractor(
            "aperiodic",
            0,
            np.sort(lanes),
            points[group[0]],
            None,
            _take_lane(later_ends.state, int(group[0])),
        )
        for group, lanes in zip(sets, members, strict=True)
    ]
    transient = np.setdiff1d(_aperiodic_lanes(end), np.concatenate([*members, []]).astype(int))
    if len(transient):
        later = run_until_settled(
            scene, take_lanes(end.state, transient), VERDICT_PERIODS, aim.steps, aim.method, ticker
        )
        end = _with_settled_lanes(end, transient, later)
    return end, attractors


def _aperiodic_lanes(end: LaneEnds) -> np.ndarray:
    """The lanes that have neither settled on an orbit nor stopped."""
    return np.flatnonzero((end.number == 0) & (end.status == Status.OK))


def _with_settled_lanes(end: LaneEnds, lanes: np.ndarray, later: LaneEnds) -> LaneEnds:
    """The lane ends, with those lanes replaced that have settled or stopped later."""
    is_final = (later.number > 0) | (later.status != Status.OK)
    return replace_lanes(end, lanes[is_final], take_lanes(later, is_final))


def _distinct_sets(points: FloatArray, unassigned: np.ndarray) -> list[np.ndarray]:
    """The lanes of each set; a lane for which this cannot be decided is in none."""
    sets = []
    while len(unassigned):
        same_set = {i: fill_one_set(points[unassigned[0]], points[i]) for i in unassigned[1:]}
        members = np.array([unassigned[0], *(i for i, same in same_set.items() if same)])
        if len(members) > 1 or None not in same_set.values():
            sets.append(members)
        unassigned = np.setdiff1d(unassigned, members)
    return sets


def _lasting_sets(scene: Scene, states: State, sets: list[np.ndarray], aim: ShootingOptions) -> list[np.ndarray]:
    """The sets whose first lane, continued from its state, is judged to be chaotic or quasi-periodic."""
    if not sets:
        return []
    firsts = stacked([_take_lane(states, int(members[0])) for members in sets])
    results = verdicts(repeat_lane(scene, len(sets)), firsts, 0, aim)
    return [members for members, verdict in zip(sets, results, strict=True) if verdict.kind in LASTING_KINDS]


def nearest_distances(attractors: list[Attractor]) -> np.ndarray:
    """The distance of each attractor from the nearest other one, in sizes of the motion; inf if there is only one."""
    distances = [
        min(
            (mean_nearest_distance(attractor.points, other.points) for other in attractors if other is not attractor),
            default=np.inf,
        )
        for attractor in attractors
    ]
    return np.array(distances, float)
