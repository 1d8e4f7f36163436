"""The static position of blades whose contact is asked to stay in one state, and that state at every interface."""

from dataclasses import replace
from functools import partial
from typing import Any, Literal, NamedTuple

import equinox as eqx
import jax
import numpy as np

from jaxshroud.linear.equilibrium import (
    PRESSED,
    alike_contact,
    friction_free,
    held_directions,
    least_energy_equilibria,
    meets_at_corners,
    of_alike_at_rest,
    position_in,
    springs_of,
)
from jaxshroud.linear.load_path import loaded_equilibria
from jaxshroud.model.modes import FLAT, Mode
from jaxshroud.scene.scene import Contact, Scene, without_given
from jaxshroud.scene.speed import ORDER
from jaxshroud.scene.typed import FloatArray

LinearState = Literal["apart", "stuck"]
POINTS_OF_RANGE = 65  # speeds at which it is looked whether faces are pressed together
SLOWEST = 1e-9  # of the end of a range: no speed is less
SHARP = 4 * float(np.finfo(float).eps)  # of a speed at which faces open


class HeldContact(NamedTuple):
    """The static position of lanes and the state of contact in which they stay."""

    q: Any  # (lanes, 3, blades)
    mode: Any  # (lanes, interfaces, points)
    case: Any  # (lanes, interfaces)
    u_s: Any  # (lanes, interfaces, points) [m]
    rigid: Any  # (lanes, 3 blades, n) directions in which the blocks can move, see `directions`
    at_rest: Any  # (lanes,) the least normal force [N], or gap [m]: no motion keeps the state where it is not positive


def sprung(scenes: Scene) -> Scene:
    """Scenes with contact by springs that begins and ends, whatever their law, and without misprints of forces."""
    c = scenes.contact
    reading = c.reading & {"corner_angles"}
    if scenes.parts.contact == "spring" and reading == c.reading:
        return scenes
    contact = Contact(c.k, c.gamma, reading, points=c.points)
    return replace(scenes, contact=contact, parts=scenes.parts._replace(contact="spring"), laws=None)


def is_linear(scenes: Scene) -> bool:
    """Whether scenes are asked to stay in one state of contact."""
    return scenes.parts.contact in ("apart", "stuck")


def held_contact(scenes: Scene, state: LinearState) -> HeldContact:
    """The static position of scenes (leading axis) in a state of contact.

    Faces that are asked to stick and that the static equilibrium leaves open are held together: their margin says so.
    After loads from rest the sliders are where these have left them.
    """
    if state == "stuck" and scenes.start == "from rest":
        return _stuck_after_loads(sprung(scenes))
    return of_alike_at_rest(partial(_contact_held_in, state=state), friction_free(without_given(sprung(scenes))))


def _stuck_after_loads(scenes: Scene) -> HeldContact:
    """The equilibria of scenes (leading axis) after loads from rest, with all faces stuck where they are."""
    rest = loaded_equilibria(scenes)
    springs = springs_of(scenes)
    stuck = rest.contact._replace(mode=np.full_like(rest.contact.mode, Mode.STICK))
    N = np.where(np.isnan(rest.q[:, :1, :1]), np.nan, rest.at.N)  # unknown where no path was found
    return HeldContact(
        q=rest.q,
        mode=stuck.mode,
        case=stuck.case,
        u_s=stuck.u_s,
        rigid=held_directions(springs, stuck),
        at_rest=_least(N),
    )


def _least(of_points: np.ndarray) -> np.ndarray:
    """The least of numbers (lanes, interfaces, points) of each lane."""
    return np.min(of_points, axis=(1, 2), initial=np.inf)


def _contact_held_in(scenes: Scene, state: LinearState) -> HeldContact:
    springs = springs_of(scenes)
    apart = state == "apart"
    contact = alike_contact(scenes, Mode.APART, 0) if apart else alike_contact(scenes, PRESSED, 4)
    q = np.zeros((len(springs.load), 3, springs.blades))
    if not apart and meets_at_corners(scenes):  # at which corners the faces touch, or whether flat
        rest = least_energy_equilibria(scenes)
        lost = np.any(np.isnan(rest.q), axis=(1, 2))
        is_open = np.equal(rest.contact.mode, Mode.APART).any(axis=-1) | lost[:, None]
        contact = contact._replace(case=np.where(is_open, FLAT, rest.contact.case).astype(np.int32))
        q = np.where(lost[:, None, None], 0.0, rest.q)
    q, at = position_in(scenes, springs, contact, q)
    return HeldContact(
        q=q,
        mode=contact.mode if apart else np.full_like(contact.mode, Mode.STICK),
        case=contact.case,
        u_s=contact.u_s if apart else at.u,
        rigid=held_directions(springs, contact),
        at_rest=_least(-at.open_v if apart else at.N),
    )


def pressed_speeds(scene: Scene, ends: tuple[float, float]) -> list[tuple[float, float]]:
    """The ranges of speeds [rad/s] within `ends` in which all faces are pressed together at rest."""
    from scipy.optimize import root_scalar

    start, stop = ends
    order = abs(float(scene.given[ORDER]))

    def least(speeds: FloatArray) -> FloatArray:
        """The least normal force at speeds [N]; nothing is asked at speed 0 itself, where a flow has no frequency."""
        scenes = jax.tree.map(lambda a: np.broadcast_to(a, (len(speeds), *np.shape(a))), without_given(scene))
        omega = order * np.maximum(speeds, SLOWEST * stop)
        found = held_contact(eqx.tree_at(lambda s: s.drive.omega, scenes, omega), "stuck").at_rest
        return np.nan_to_num(found, nan=-1.0)

    speeds = np.linspace(start, stop, POINTS_OF_RANGE)
    pressed = least(speeds) > 0
    changes = [
        root_scalar(lambda v: least(np.array([v]))[0], bracket=speeds[i : i + 2], xtol=SHARP * stop, rtol=SHARP).root
        for i in np.flatnonzero(pressed[1:] != pressed[:-1])
    ]
    edges = [*([start] if pressed[0] else []), *changes, *([stop] if pressed[-1] else [])]
    return list(zip(edges[::2], edges[1::2], strict=True))


def displaced_by_interference(scenes: Scene, gaps: FloatArray) -> FloatArray:
    """The displacement of each block where interference presses the faces of one lane together, at rest, (blades,) [m].

    The faces slide freely, and lumped blades do not turn.

    Args:
        scenes: The lane.
        gaps: The gap at each interface without contact, (interfaces,); faces are together where it is negative.
    """
    if np.all(gaps >= 0):
        return np.zeros(scenes.layout.blades)
    scenes = friction_free(sprung(scenes))
    springs = springs_of(scenes)
    if scenes.mode_numbers is None:
        springs = springs._replace(moves=springs.moves & (np.arange(len(springs.moves)) < 2 * springs.blades))

    def displacements(mode: Any) -> FloatArray:
        contact = alike_contact(scenes, mode, 1)
        return position_in(scenes, springs, contact, np.zeros((1, 3, springs.blades)))[0][0]

    x, y, _ = displacements(np.where(gaps < 0, PRESSED, Mode.APART)) - displacements(Mode.APART)
    return np.hypot(x, y)
