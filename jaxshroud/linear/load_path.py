"""Where mean loads leave blades that rub, if they are applied slowly and in proportion from the unloaded position.

The path is followed from event to event. Within a state of contact Newton's method finds the equilibrium under a share
of the loads; where a guard of a march is crossed, the share is located, the state changes as in a march, and goes on if
what then follows from a little more load agrees with it, see `path_events`. Lanes ask for equilibria in generators of
their own, which are answered together.
"""

from collections.abc import Generator
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxshroud.linear.equilibrium import (
    CHANGES_AT_ONCE,
    MOST_CHANGES,
    NUMBERS_AT_ONCE,
    ContactState,
    Equilibrium,
    Springs,
    contact_at,
    displacements_under,
    equilibria_under,
    equilibrium_at,
    friction_free,
    in_pieces,
    meets_at_corners,
    of_alike_at_rest,
    passed_on,
    position_in,
    rubs,
    springs_of,
    static_equilibria,
    unbalanced,
    with_float64,
)
from jaxshroud.linear.path_events import PathEvents, path_events
from jaxshroud.model.modes import Mode
from jaxshroud.scene.scene import Scene, without_given
from jaxshroud.scene.typed import FloatArray

STEP = 1 / 64  # of the loads, where blocks turn; without that, equilibria in one state are linear in the loads
SHORTEST_STEP = 1e-6  # beyond which nothing follows: the blocks snap, or there is no equilibrium
STRAYED = 0.5  # of a step: an equilibrium farther from where the last one points to is not on its path
ROUNDED = 1e-9  # of the largest displacement: a step that is no longer does not stray
MOST_EVENTS = 1000  # of a path
MOST_TRIALS = 100  # to locate an event
LOCATED = 4 * float(np.finfo(float).eps)  # shares of the loads that differ by less are one


class Trial(NamedTuple):
    """What a lane asks for: the equilibrium in a state of contact under a share of the loads."""

    share: float
    contact: ContactState  # without the axis of lanes
    q: FloatArray  # (3, blades) where it is sought


class Placed(NamedTuple):
    """One lane in equilibrium under a share of its mean loads."""

    share: float
    q: FloatArray  # (3, blades)
    rate: FloatArray  # (3, blades) its derivative by the share
    contact: ContactState  # without the axis of lanes, as the next
    events: PathEvents


Walk = Generator[Trial, Placed | None, Placed | None]  # None: there is no such equilibrium; the path cannot be followed


def loaded_equilibria(scenes: Scene) -> Equilibrium:
    """The equilibria of scenes (leading axis) after their mean loads have been applied slowly, in proportion.

    The path begins in the static equilibrium without mean loads and without friction, with the sliders where the faces
    then are. A lane has NaN where its path cannot be followed, as where blades snap.
    """
    return of_alike_at_rest(_in_pieces, jax.tree.map(with_float64, without_given(scenes)))


def start_equilibria(scenes: Scene) -> Equilibrium:
    """The equilibria in which scenes (leading axis) with a static start begin, see `Scene.start`."""
    return loaded_equilibria(scenes) if scenes.start == "from rest" else static_equilibria(scenes)


def _in_pieces(scenes: Scene) -> Equilibrium:
    return in_pieces(_loaded_piece, (scenes,), NUMBERS_AT_ONCE)


def _loaded_piece(scenes: Scene) -> Equilibrium:
    springs = springs_of(scenes)
    if scenes.parts.contact == "none":
        return equilibria_under(springs, scenes)
    unloaded = equilibria_under(springs._replace(load=0 * springs.load), friction_free(scenes))
    contact = _unloaded_state(unloaded, scenes)
    step = STEP if "theta" in scenes.parts.motion else 1.0
    walks = [_path(_lane(contact, i), q, step) for i, q in enumerate(unloaded.q)]
    ends = _walked(walks, scenes, springs)
    followed = np.array([end is not None for end in ends])
    last = [_lane(contact, i) if end is None else end.contact for i, end in enumerate(ends)]
    q = np.array([unloaded.q[i] if end is None else end.q for i, end in enumerate(ends)])
    state = jax.tree.map(lambda *a: np.stack(a), *last)
    return equilibrium_at(springs, state, contact_at(scenes, q, state), q, followed)


def _unloaded_state(unloaded: Equilibrium, scenes: Scene) -> ContactState:
    """The state of contact without loads: what is pressed sticks, where there is friction."""
    k = jax.tree.map(jnp.asarray, scenes).k
    sticks = rubs(scenes) & np.asarray(k > 0)
    pressed = np.where(sticks.reshape(len(sticks), -1, 1), Mode.STICK, Mode.SLIP_PLUS)
    at, mode = unloaded.contact, unloaded.contact.mode
    mode = np.where(np.equal(mode, Mode.APART), mode, pressed).astype(np.int32)
    fixed = 0 if scenes.points else 1  # without corners all cases are alike; marches have these
    return at._replace(mode=mode, case=at.case if meets_at_corners(scenes) else np.full_like(at.case, fixed))


def _lane(tree, i: int):
    return jax.tree.map(lambda a: a[i], tree)


def _walked(walks: list[Walk], scenes: Scene, springs: Springs) -> list[Placed | None]:
    """The ends of the paths of lanes; what they ask for in turn is found for all at once."""
    trials: list[Trial] = [next(walk) for walk in walks]
    ends: list[Placed | None] = [None] * len(walks)
    going = set(range(len(walks)))
    while going:
        answers = _answers(trials, scenes, springs)
        for i in sorted(going):
            try:
                trials[i] = walks[i].send(answers[i])
            except StopIteration as end:
                ends[i] = end.value
                going.remove(i)
    return ends


def _answers(trials: list[Trial], scenes: Scene, springs: Springs) -> list[Placed | None]:
    """What the trials of all lanes ask for."""
    contact = jax.tree.map(lambda *a: np.stack(a), *[trial.contact for trial in trials])
    share = np.array([trial.share for trial in trials])
    loaded = springs._replace(load=share[:, None] * springs.load)
    q, at = position_in(scenes, loaded, contact, np.stack([trial.q for trial in trials]))
    rate = displacements_under(np.where(springs.moves, springs.load, 0.0), springs, contact, at)
    passed = passed_on(springs, contact, unbalanced(loaded, at, q))
    events = path_events(scenes, q, rate, contact, at.end_torques + passed[..., None])
    events = jax.tree.map(with_float64, events)
    lost = np.atleast_1d(np.isnan([q, rate]).any(axis=(0, 2, 3)))
    placed = [Placed(trial.share, q[i], rate[i], trial.contact, _lane(events, i)) for i, trial in enumerate(trials)]
    return [None if gone else one for one, gone in zip(placed, lost, strict=True)]


def _path(contact: ContactState, q: FloatArray, step: float) -> Walk:
    """The path of one lane from the unloaded position, in steps of the loads that are no longer than one."""
    now = None if np.isnan(q).any() else (yield Trial(0.0, contact, q))
    for _ in range(MOST_EVENTS):
        now = yield from _agreed(now)
        if now is None or now.share == 1:
            return now and now._replace(contact=now.contact._replace(u_s=now.events.u_s))
        now = yield from _to_next_event(now, step)
    return None


def _agreed(now: Placed | None) -> Walk:
    """The lane under the same loads in a state of contact that lasts under a little more of them."""
    for change in range(MOST_CHANGES):
        if now is None or not now.events.leaves.any():
            return now
        happens = now.events.leaves
        if change >= CHANGES_AT_ONCE:  # which go round in circles: some of them, drawn alike in every run
            happens = happens & (np.random.default_rng(change).random(happens.shape) < 0.5)
        now = yield from _changed(now, happens)
    return None


def _changed(now: Placed, happens: np.ndarray) -> Walk:
    """The lane under the same loads after the event of each interface that takes precedence of those that happen."""
    kind = np.argmax(happens, axis=1)
    fires = happens.any(axis=1)

    def changed(after: np.ndarray, own: np.ndarray) -> np.ndarray:
        chosen = after[np.arange(len(kind)), kind]
        return np.where(fires.reshape(-1, *(1,) * (own.ndim - 1)), chosen, own)

    return (yield Trial(now.share, jax.tree.map(changed, now.events.after, now.contact), now.q))


def _to_next_event(now: Placed, most: float) -> Walk:
    """The lane in the state after the next event, or under all of its loads if there is none."""
    step = most
    while now.share < 1:
        there = yield from _further(now, min(now.share + step, 1.0))
        if there is None:
            step /= 2
            if step < SHORTEST_STEP:
                return None
        elif there.events.crossed.any():
            return (yield from _located(now, there))
        else:
            now = there
            step = min(2 * step, most)
    return now


def _further(now: Placed, share: float) -> Walk:
    """The lane in its state of contact under a share of the loads; None where no equilibrium continues the path."""
    ahead = (share - now.share) * now.rate
    there = yield Trial(share, now.contact, now.q + ahead)
    if there is None:
        return None
    strayed = np.abs(there.q - now.q - ahead).max() > STRAYED * np.abs(ahead).max() + ROUNDED * np.abs(there.q).max()
    return None if strayed else there


def _located(low: Placed, high: Placed) -> Walk:
    """The lane after the first event between two shares of the loads, at the higher one of which guards are crossed."""
    for trial in range(MOST_TRIALS):
        if high.share - low.share <= LOCATED:
            break
        there = yield from _further(low, (low.share + high.share) / 2 if trial % 3 == 2 else _estimate(low, high))
        if there is None:
            return None
        if there.events.crossed.any():
            high = there
            continue
        fires = there.events.reached & high.events.crossed
        if fires.any():
            return (yield from _changed(there, fires))
        low = there
    return (yield from _changed(high, high.events.crossed))


def _estimate(low: Placed, high: Placed) -> float:
    """The share at which the first guard is crossed, linearly between two; their middle where that says nothing."""
    crossed = high.events.crossed
    begin, end = (one.events.value[crossed] for one in (low, high))
    share = low.share + float(np.min(-begin / (end - begin))) * (high.share - low.share)
    return share if low.share < share < high.share else (low.share + high.share) / 2
