"""Whether the settled motion of a scene about its static equilibrium is linear: in which state, how safely."""

import jax
import numpy as np

from jaxshroud.batch.equilibrium import Equilibrium
from jaxshroud.batch.held_contact import LinearState, held_contact, sprung
from jaxshroud.batch.linear_motion import LinearMotion, linear_motions
from jaxshroud.batch.linear_runs import linear_status
from jaxshroud.batch.load_path import start_equilibria
from jaxshroud.batch.xla import one_lane
from jaxshroud.model.modes import Mode, Status
from jaxshroud.results.data_sheet import SettledMotion
from jaxshroud.scene.layout import SPRUNG
from jaxshroud.scene.preload import is_preloaded
from jaxshroud.scene.scene import Scene, without_given


def has_settled_motion(scene: Scene) -> bool:
    """Whether it is judged: of lumped blades with located contact that are loaded at rest, or begin there."""
    judged = scene.start != "motion" or is_preloaded(scene) or scene.parts.contact in SPRUNG[1:]
    located = scene.parts.contact in SPRUNG and not scene.contact.reading
    return judged and located and scene.blade_matrices is None


def settled_motion(scene: Scene) -> SettledMotion:
    """The judgement of a scene."""
    lanes: Scene = jax.tree.map(np.asarray, one_lane(without_given(sprung(scene))))
    rest = start_equilibria(lanes)
    is_apart = rest.contact.mode == Mode.APART
    exact = "theta" not in scene.parts.motion
    equilibria = int(rest.found[0])
    if not equilibria or (is_apart.any() and not is_apart.all()):
        return SettledMotion("", _without_state(scene, equilibria), exact, equilibria)
    state: LinearState = "apart" if is_apart.all() else "stuck"
    motion = linear_motions(lanes, held_contact(lanes, state))
    return _judgement(state, motion, rest, exact, _rubs(scene))


def _without_state(scene: Scene, equilibria: int) -> str:
    """Why there is no state of contact in which the motion could stay."""
    if equilibria:
        return "faces are apart at some interfaces alone"
    if scene.start == "from rest":
        return "the loads cannot be followed from the unloaded position: blades snap, or corners meet at one height"
    return "no static equilibrium was found"


def _rubs(scene: Scene) -> bool:
    """Whether there is friction at any interface."""
    numbers = scene.friction.mu, scene.friction.k_d
    return scene.parts.friction != "none" and bool(np.all([np.any(np.asarray(a) > 0) for a in numbers]))


def _judgement(state: LinearState, motion: LinearMotion, rest: Equilibrium, exact: bool, rubs: bool) -> SettledMotion:
    least = {name: float(np.min(a)) for name, a in motion.margins._asdict().items()}
    name = "in contact" if state == "stuck" and not rubs else state
    holds = linear_status(motion)[0] == Status.OK
    reason = ""
    if not holds:
        other = state == "stuck" and least["N"] > 0 and float(np.min(motion.other_rest)) > 0
        reason = "may settle to sticking with the sliders elsewhere" if other else "contact leaves the state"
    return SettledMotion(name if holds else "", reason, exact, int(rest.found[0]), **least)
