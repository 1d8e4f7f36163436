"""Whether the settled motion of a scene about its static equilibrium is linear: in which state, and how safely.

Contact is asked to stay in one state, or does so by itself: then the motion has a closed form.
"""

from dataclasses import replace
from typing import cast, overload

import jax
import numpy as np

from jaxshroud.batch.closed_form import linear_status
from jaxshroud.batch.xla import one_lane
from jaxshroud.linear.equilibrium import Equilibrium, rubs, static_equilibria
from jaxshroud.linear.held_contact import LinearState, held_contact, is_linear, pressed_speeds, sprung
from jaxshroud.linear.linear_motion import LinearMotion, linear_motions
from jaxshroud.linear.linear_transient import outlasts_transient
from jaxshroud.linear.load_path import start_equilibria
from jaxshroud.model.modes import Mode, Status
from jaxshroud.results.data_sheet import SettledMotion
from jaxshroud.scene.checks import InputError, word_argument
from jaxshroud.scene.file import SceneFile
from jaxshroud.scene.layout import SPRUNG
from jaxshroud.scene.other_parts import with_parts
from jaxshroud.scene.scene import Scene, without_given
from jaxshroud.scene.sector import smallest_ring
from jaxshroud.scene.speed import ORDER
from jaxshroud.scene.title import display_value
from jaxshroud.signals.amplitudes import is_preloaded
from jaxshroud.verbs.arguments import Asked, MethodArgument
from jaxshroud.verbs.lanes import flatten_lanes, leading_axes

SPEED = ("drive", "speed")  # whose unit messages have
DIED_OUT = 1e-3  # of a free vibration
MANY_PERIODS = 100  # in which it dies out
TOUCHING_PERIODS = 40  # after which averages of faces that touch in most periods stand


def has_settled_motion(scene: Scene) -> bool:
    """Whether it is judged: of lumped blades with located contact that are loaded at rest, or begin there."""
    judged = scene.start != "motion" or is_preloaded(scene) or scene.parts.contact in SPRUNG[1:]
    located = scene.parts.contact in SPRUNG and not scene.contact.reading
    return judged and located and scene.mode_numbers is None


def settled_motion(scene: Scene) -> SettledMotion:
    """The judgement of a scene."""
    lanes, _ = smallest_ring(jax.tree.map(np.asarray, one_lane(without_given(sprung(scene)))))
    rest = start_equilibria(lanes)
    exact = "theta" not in scene.parts.motion
    equilibria = int(rest.found[0])
    state = _state_at_rest(rest)
    if not equilibria or state is None:
        return SettledMotion("", _without_state(scene, equilibria), exact, equilibria)
    motion = linear_motions(lanes, held_contact(lanes, state))
    return _judgement(state, motion, rest, exact, bool(np.any(rubs(scene))))


def _state_at_rest(rest: Equilibrium) -> LinearState | None:
    """The one state of contact at all interfaces of all lanes; None where there are both."""
    is_apart = rest.contact.mode == Mode.APART
    if is_apart.all():
        return "apart"
    return None if is_apart.any() else "stuck"


def _without_state(scene: Scene, equilibria: int) -> str:
    """Why there is no state of contact in which the motion could stay."""
    if equilibria:
        return "faces are apart at some interfaces alone"
    if scene.start == "from rest":
        return "the loads cannot be followed from the unloaded position: blades snap, or corners meet at one height"
    return "no static equilibrium was found"


def kept_state(scenes: Scene) -> LinearState | None:
    """The one state of contact that each of scenes (leading axis) keeps from its start on; None where there is none.

    It is said of scenes that begin in their static equilibrium, the only one, and whose blades do not turn: their
    settled motion is the closed form, and not nearly.
    """
    judged = scenes.start == "static" and scenes.parts.contact == "spring" and "theta" not in scenes.parts.motion
    if not judged or scenes.mode_numbers is not None:
        return None
    lanes, _ = smallest_ring(jax.tree.map(np.asarray, without_given(scenes)))
    rest = static_equilibria(lanes)
    state = _state_at_rest(rest)
    if state is None or np.any(rest.found != 1):
        return None
    held = held_contact(lanes, state)
    motion = linear_motions(lanes, held)
    keeps = np.all(linear_status(motion) == Status.OK) and outlasts_transient(lanes, held, motion)
    return state if keeps else None


def settling_periods(scenes: Scene) -> float:
    """The drive periods in which the slowest free vibration of scenes (leading axis) falls to `DIED_OUT`.

    It is inf where a coordinate is not damped, and NaN for blades by matrices.
    """
    if scenes.mode_numbers is not None:
        return float("nan")
    omega = np.asarray(scenes.drive.omega, float)[:, None]
    slowest = np.inf
    for name in scenes.parts.motion:
        m, c, k = (np.asarray(a, float) for a in scenes.mistuned_blades.oscillators[name])
        damping, square = c / (2 * m), k / m
        creeps = np.sqrt(np.maximum(damping**2 - square, 0.0))
        slowest = min(slowest, float(np.min((damping - creeps) / omega)))
    return float(-np.log(DIED_OUT) / (2 * np.pi * slowest)) if slowest > 0 else np.inf


def settling_advice(periods: float, touches: bool, discarded: str = "") -> str:
    """What to do about light damping, whose free vibration takes so many drive periods to decay; else empty.

    `discarded` says how many are discarded. What is said of faces that touch was measured by
    `tests/studies/wheel_periods.py`.
    """
    if not periods > MANY_PERIODS:  # nor NaN
        return ""
    advice = f"free motion is not damped and never decays{discarded}"
    if np.isfinite(periods):
        transient = f"{10 * np.ceil(periods / 10):.0f}"
        advice = f"free motion needs {periods:.0f} periods to decay to 0.1 %{discarded}: add --transient {transient}"
    sooner = f"; where faces touch, averages stand after some {TOUCHING_PERIODS} periods: rather keep more of them"
    return f"{advice}{sooner if touches else ''}"


def _judgement(
    state: LinearState, motion: LinearMotion, rest: Equilibrium, exact: bool, has_friction: bool
) -> SettledMotion:
    least = {name: float(np.min(a)) for name, a in motion.margins._asdict().items()}
    name = "in contact" if state == "stuck" and not has_friction else state
    holds = linear_status(motion)[0] == Status.OK
    reason = ""
    if not holds:
        other = state == "stuck" and least["N"] > 0 and float(np.min(motion.other_rest)) > 0
        reason = "may settle to sticking with the sliders elsewhere" if other else "contact leaves the state"
    return SettledMotion(name if holds else "", reason, exact, int(rest.found[0]), **least)


@overload
def in_state(scene: SceneFile, state: LinearState | None) -> SceneFile: ...
@overload
def in_state(scene: Scene, state: LinearState | None) -> Scene: ...
@overload
def in_state(scene: Scene | SceneFile, state: LinearState | None) -> Scene | SceneFile: ...
def in_state(scene: Scene | SceneFile, state: LinearState | None) -> Scene | SceneFile:
    """The scene with contact that stays in a state; as it is where none is requested.

    Raises:
        InputError: There is no such state, or contact of this kind has none.
    """
    if state is None:
        return scene
    word_argument("linear", state, LinearState)
    parts = scene.tables["parts"] if isinstance(scene, SceneFile) else scene.parts._asdict()
    if parts["contact"] not in SPRUNG:
        raise InputError(f'Argument `linear` is of contact by springs, not of parts.contact = "{parts["contact"]}".')
    if isinstance(scene, SceneFile):
        return replace(scene, tables={**scene.tables, "parts": {**parts, "contact": state}})
    return with_parts(scene, scene.parts._replace(contact=state))


def require_state(scenes: Scene, runs: int = 1) -> None:
    """Raise an InputError where contact is asked to stay in a state that none of scenes (leading axis) keeps at rest.

    A motion is about the position at rest, and takes from its margins. Each so many scenes, the `runs` of a design,
    have to keep it together.
    """
    if not is_linear(scenes):
        return
    ring, _ = smallest_ring(without_given(scenes))
    state = cast(LinearState, scenes.parts.contact)
    margin = held_contact(ring, state).at_rest
    worst = margin.reshape(-1, runs).min(axis=1)
    if not np.all(worst <= 0):  # NaN: nothing is known of it
        return
    of = f"{len(worst)} designs, in all conditions," if runs > 1 else f"{len(worst)} scenes"
    which = "The scene does not keep" if len(margin) == 1 else f"None of {of} keeps"
    reason = (
        "at rest they are pressed together" if state == "apart" else _open_text(scenes, int(np.argmax(worst)) * runs)
    )
    raise InputError(f"{which} its faces {state}: {reason}; march it.")


def _open_text(scenes: Scene, at: int) -> str:
    """That faces are open at rest; where they depend on the speed, above which those of one of the scenes are."""
    reason = "at rest they are not pressed together"
    if not scenes.depends_on_speed:
        return reason
    one = jax.tree.map(lambda a: np.asarray(a)[at], scenes)
    fastest = float(np.max(np.asarray(scenes.drive.omega) / np.abs(np.asarray(scenes.given[ORDER]))))
    pressed = pressed_speeds(one, (0.0, fastest))
    if not pressed:
        return f"{reason} at any speed up to {display_value(*SPEED, fastest)}"
    return f"{reason} above {display_value(*SPEED, pressed[-1][1])}"


def default_state(scenes: Scene | SceneFile, method: MethodArgument) -> LinearState | None:
    """The state of contact in which a closed form takes the place of a march; None where it is to march.

    It does where all `scenes` keep one state from their static start on, unless the argument `method` says how to
    march.
    """
    by_file = isinstance(method, Asked) and not method.by_argument
    if method is not None and not by_file:
        return None
    scene = scenes.scene if isinstance(scenes, SceneFile) else scenes
    return kept_state(flatten_lanes(scene, len(leading_axes(scene))))
