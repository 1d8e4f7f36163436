"""Lyapunov exponents of a scene's motion, or of many scenes'."""

from collections.abc import Sequence

import numpy as np

from jaxshroud.batch.runs import Progress
from jaxshroud.batch.states import STATE
from jaxshroud.batch.threads import Interrupted
from jaxshroud.march.method import Choices, Method
from jaxshroud.march.stability import Steps
from jaxshroud.model.modes import Status
from jaxshroud.model.state import State
from jaxshroud.motion.lyapunov import ALIGNING, Exponents, exponents
from jaxshroud.motion.together import together
from jaxshroud.results.lyapunov import Lyapunov
from jaxshroud.scene.file import SceneFile
from jaxshroud.scene.scene import Scene
from jaxshroud.verbs.lanes import lanes_of, of_all, told


def lyapunov(
    scene: Scene | SceneFile,
    *,
    n_periods: int | None = None,
    transient: int | None = None,
    steps_per_period: Steps | None = None,
    method: Method | Choices | None = None,
    accuracy: str | float | None = None,
    state: State | None = None,
    progress: Progress | None = None,
    throw: bool = False,
    dims: Sequence[str] | None = None,
) -> Lyapunov:
    """Exponents of the motion that a scene settles on.

    Args:
        scene: One scene, or many with leading axes, which then come first in all results; or a scene file, whose [run]
            counts where an argument is not given.
        n_periods: Drive periods averaged over; by default 64.
        transient: Drive periods run and discarded first; by default 64.
        steps_per_period: Runge-Kutta steps in one period; "auto": as many as the stiffest lane needs, as where only a
            method is given.
        method: How to march; where only steps are given RK4, with events located by the guard's cubic.
        accuracy: "fast", "balanced" (the default where nothing is said of steps or method), "reference" or a number:
            chooses steps and method, in float64.
        state: Where to start, at drive phase 0, one for all lanes or each its own; by default `scene.initial`, apart.
        progress: Called with (lane-periods done, lane-periods at most).
        throw: Raise where a lane stops, rather than give it a status.
        dims: Names of the leading axes; by default `lane`.

    Returns:
        The exponents, by QR factors of the product of the periods' Jacobians. After the transient the tangents start in
        random directions; the average begins when two frames of them grow alike, or 64 periods later (where directions
        grow equally fast, no order emerges). They do not start earlier: along a motion that still changes, they may
        take an order that is not the settled motion's, and keep it for long. The interval is by batch means.

    Raises:
        ValueError: A count is too small, or float64 is not to be had.
        NumericalError: With `throw`: a lane stopped.
        Interrupted: Ctrl-C; its `done` has the lanes that had ended, None where none had.

    Example:
        >>> import jax; jax.config.update("jax_enable_x64", True)
        >>> import jaxshroud as js
        >>> scene = js.load("table1", ['parts.motion=["x"]', "blades.c_x=40"]).scene
        >>> found = js.lyapunov(scene, n_periods=8, transient=8, steps_per_period=100)
        >>> bool(found.exponents[0] < 0)
        True
    """
    lanes = lanes_of(
        scene,
        n_periods=n_periods,
        transient=transient,
        steps_per_period=steps_per_period,
        method=method,
        accuracy=accuracy,
        dims=dims,
    )
    kept, before, march = lanes.asked.n_periods, lanes.asked.transient, lanes.how
    begun = lanes.begun(lanes.scenes, state)
    looked_for = [exponents(*lane, kept, before, march.steps, march.method) for lane in begun]

    def missing(lane: int, flag: str) -> Exponents:
        status = Status.NOT_RUN if flag == "not run" else Status.NOT_FINITE
        nothing = np.full(STATE, np.nan)
        return Exponents(nothing, nothing, np.empty((0, STATE)), status, begun[lane][1])

    result = lambda found: Lyapunov.of_exponents(found, lanes.shape, **lanes.about)  # noqa: E731
    most = before + ALIGNING + kept
    try:
        found = of_all(lambda: together(looked_for, progress, most), missing, throw or not lanes.shape)
    except Interrupted as stopped:
        raise Interrupted(stopped.done and result(stopped.done)) from None
    return told(result(found), throw)
