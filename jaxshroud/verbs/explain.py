"""What the model of a scene consists of, what it leaves out, and what that costs."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxshroud.batch.loop import advance
from jaxshroud.batch.periods import begin_lanes
from jaxshroud.batch.xla import alone, plain
from jaxshroud.march.events import Kind
from jaxshroud.march.lane import Fixed, Lane, grid
from jaxshroud.march.method import FAST, Choices, Method, choices
from jaxshroud.march.stability import largest_frequency, limits, steps_for
from jaxshroud.model.linear import steady_amplitudes
from jaxshroud.model.ready import model
from jaxshroud.model.state import start
from jaxshroud.scene.file import SceneFile
from jaxshroud.scene.parts import MOTIONS, Parts
from jaxshroud.scene.scene import Scene, with_parts
from jaxshroud.verbs.lanes import one_scene

# Bookkeeping of types and of transformations, which no machine executes.
NO_OPERATION = {
    "stop_gradient",
    "convert_element_type",
    "broadcast_in_dim",
    "reshape",
    "squeeze",
    "optimization_barrier",
}
EVENTS = {Kind.LIFT: "contact", Kind.TURN: "corner pair", Kind.HEIGHT: "tip", Kind.RUB: "friction"}


@dataclass(frozen=True)
class Explained:
    """A scene's model in numbers."""

    parts: Parts
    numbers: int  # that a lane carries through the march
    events: tuple[str, ...]  # kinds that are looked for
    operations: int  # of one trial step; 0 where there is a closed form
    full_operations: int  # of the full model's
    omega_max: float  # largest frequency [rad/s]
    steps: dict[str, int]  # least stable, least accurate and automatic steps per period
    advice: tuple[str, ...]  # what the scene could do without


def explain(scene: Scene | SceneFile, method: Method | Choices | None = None) -> Explained:
    """What the scene's model consists of.

    Args:
        scene: One scene.
        method: How it is marched; by default RK4 with events located by the guard's cubic, in float64.

    Returns:
        Counts of numbers and operations, steps per period, and what the scene could do without.

    Raises:
        ValueError: There are many scenes.

    Example:
        >>> import jax; jax.config.update("jax_enable_x64", True)
        >>> import jaxshroud as js
        >>> told = js.explain(js.load("table1", ['parts.motion=["x"]', 'parts.friction="none"']))
        >>> told.events
        ('contact',)
    """
    scene, method = one_scene("explain", scene), choices(FAST if method is None else method)
    closed = scene.parts.contact == "none"
    full = with_parts(scene, Parts())
    lane = _ready(scene, method)[0]
    omega_max, period = float(largest_frequency(scene)), float(scene.drive.period)
    steps = {}
    if not method.taylor:
        stable, accurate = limits(method.rk)
        steps = {
            "stable": int(np.ceil(omega_max * period / stable)),
            "accurate": int(np.ceil(omega_max * period / accurate)),
        }
    return Explained(
        parts=scene.parts,
        numbers=0 if closed else len(jax.tree.leaves(lane)),
        events=_events(_ready(scene, FAST)[0]),
        operations=0 if closed else operations(scene, method),
        full_operations=operations(full, method),
        omega_max=omega_max,
        steps={} if closed else steps | {"auto": steps_for(scene, 0, "auto", method.tableau)},
        advice=tuple(_advice(scene)),
    )


def operations(scene: Scene, method: Choices) -> int:
    """Arithmetic, comparisons and selections in one trial step of one lane, as XLA is given them."""
    lanes, fixed = _ready(scene, method)
    traced = jax.make_jaxpr(lambda lanes, fixed: advance(lanes, fixed, method, plain))(lanes, fixed)
    return sum(_counted(traced.jaxpr))


def lowered_operations(scene: Scene, method: Choices) -> float:
    """The same by XLA's own analysis of cost: a check."""
    lowered = jax.jit(lambda lanes, fixed: advance(lanes, fixed, method, plain)).lower(*_ready(scene, method))
    analysis: Any = lowered.cost_analysis()
    return float(analysis["flops"] + analysis.get("transcendentals", 0.0))


def _counted(jaxpr: Any) -> Iterator[int]:
    """One for each operation whose result is used."""
    needed = {id(v) for v in jaxpr.outvars}
    for eqn in reversed(jaxpr.eqns):
        if not any(id(v) in needed for v in eqn.outvars):
            continue
        needed |= {id(v) for v in eqn.invars}
        inner = [getattr(v, "jaxpr", v) for v in eqn.params.values() if hasattr(getattr(v, "jaxpr", v), "eqns")]
        for part in inner:
            yield from _counted(part)
        if not inner and eqn.primitive.name not in NO_OPERATION:
            yield 1


def _ready(scene: Scene, method: Choices) -> tuple[Lane, Fixed]:
    """One lane about to start, and what it marches by."""
    scenes, states, period = alone((scene, start(scene.initial), scene.drive.period))
    stop = jnp.ones((1,), jnp.int32)
    steps = grid(jnp.zeros_like(period), stop.astype(period.dtype), period)
    return begin_lanes(scenes, states, method), Fixed(jax.vmap(model)(scenes), steps, stop)


def _events(lane: Lane) -> tuple[str, ...]:
    if lane.guards is None:
        return ()
    return tuple(text for kind, text in EVENTS.items() if jax.tree.leaves(lane.guards.value[kind]))


def _advice(scene: Scene) -> Iterator[str]:
    """What could be left out of the model without changing its motion."""
    parts, friction = scene.parts, scene.friction
    touches = parts.contact == "spring"
    if touches and parts.friction == "bilinear" and (float(friction.mu) == 0 or float(friction.k_d) == 0):
        yield 'mu or k_d is 0: [parts] friction = "none" gives the same motion for less'
    if touches and float(scene.k) == 0:
        yield 'the contact has no stiffness: [parts] contact = "none" gives the motion in closed form'
    if parts.contact != "none" and _never_touches(scene):
        yield 'the gap exceeds the steady free motion: after transients, [parts] contact = "none" may be all it takes'
    if parts.motion == MOTIONS[2] and not np.any(scene.drive.M_0) and touches:
        yield 'M_0 is 0: the blocks are turned by contact only; compare with [parts] motion = ["x", "y"]'


def _never_touches(scene: Scene) -> bool:
    """Whether corners in steady free motion stay apart, by the sum of all amplitudes."""
    free, s = steady_amplitudes(scene), scene.shroud
    x, y, theta = (float(np.sum(np.abs(a))) for a in free)
    sine = float(np.sin(s.alpha))
    return float(s.gap) * sine > x + y + theta * float(np.hypot(s.l_oa, s.l_ab))
