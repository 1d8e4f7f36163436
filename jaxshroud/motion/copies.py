"""Copies of a run that looks chaotic: does one of them settle?

Chaos may be a transient that outlasts any run, or go on beside an orbit. Copies that start a little apart part soon,
and are then so many further runs of the same chaos: together as long as one that would take far more time.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxshroud.batch.runs import Plan, run_lanes
from jaxshroud.batch.states import final_states, rows
from jaxshroud.model.modes import Status
from jaxshroud.model.state import State
from jaxshroud.motion.averages import displacements, nearness_of
from jaxshroud.motion.orbit import Cycle
from jaxshroud.motion.returns import returns
from jaxshroud.motion.shooting import NEAR, WINDOW, Aim, nearby_orbit
from jaxshroud.motion.together import together
from jaxshroud.scene.scene import Scene

COPIES = 32
APART = 1e-4  # of x, at random and at most
KEPT = 4 * WINDOW  # last periods in which a copy must return


class Settled(NamedTuple):
    """Of one lane."""

    copies: int  # that return in the end
    of: int
    q: int  # period number of the stable orbit that one of them is on; 0: there is none


def settled_copies(scenes: Scene, states: State, periods: int, aim: Aim) -> list[Settled]:
    """How many copies of each lane settle within so many periods of its state."""
    lanes = len(scenes.drive.omega)
    many, begun = jax.tree.map(lambda a: np.repeat(np.asarray(a), COPIES, axis=0), (scenes, states))
    push = 1 + APART * np.random.default_rng(0).uniform(-1, 1, (COPIES, 1))
    moved = np.asarray(begun.motion.x) * np.tile(push, (lanes, 1))
    begun = eqx.tree_at(lambda s: s.motion.x, begun, moved.astype(scenes.drive.omega.dtype))
    kept = min(KEPT, periods)
    runs = run_lanes(many, begun, Plan(periods - kept, kept, aim.steps, 0.0, aim.method), lambda _: None)
    near = nearness_of(many, runs.samples, NEAR, aim.method.precision)
    fine = np.asarray(runs.last.status) == Status.OK
    number = np.where(fine, returns(displacements(runs.samples), near).number, 0)
    back = (number > 0).reshape(lanes, COPIES)
    at, z, ends = np.flatnonzero(back.any(axis=1)), rows(runs.samples.motion), final_states(runs.last.state)
    first = at * COPIES + back[at].argmax(axis=1)
    of = lambda tree, i: jax.tree.map(lambda a: jnp.asarray(a[i]), tree)  # noqa: E731
    sought = [nearby_orbit(of(many, i), of(ends, i), int(number[i]), z[i, -WINDOW:], aim) for i in first]
    found = dict(zip(at.tolist(), together(sought), strict=True))
    return [Settled(int(back[i].sum()), COPIES, _sound(found.get(i))) for i in range(lanes)]


def _sound(cycle: object) -> int:
    """The period number of an orbit to rely upon; 0 of anything else."""
    return cycle.q if isinstance(cycle, Cycle) and cycle.sound else 0
