"""What one scene does, and why it is called so."""

from typing import Any

import numpy as np

from jaxshroud.batch.runs import Progress, Ticker
from jaxshroud.batch.xla import alone
from jaxshroud.march.method import Choices, Method
from jaxshroud.march.stability import Steps
from jaxshroud.model.modes import Status
from jaxshroud.model.state import State
from jaxshroud.motion.evidence import Stretches
from jaxshroud.motion.lyapunov import exponents
from jaxshroud.motion.shooting import TOLERANCE, Aim
from jaxshroud.motion.together import alone_found
from jaxshroud.motion.verdict import ROUNDS, Verdict, sentence, verdicts
from jaxshroud.results.diagnosis import Diagnosis
from jaxshroud.results.trajectory import Trajectory
from jaxshroud.scene.file import SceneFile
from jaxshroud.scene.scene import Scene
from jaxshroud.verbs.door import Marched
from jaxshroud.verbs.lanes import lanes_of, one_scene
from jaxshroud.verbs.power import power
from jaxshroud.verbs.simulate import simulate

SHOWN, OF_APERIODIC = 64, 128  # periods that are stored, at least, and of motion that does not repeat
ORBITS = 4  # that are stored at least
POWER = 256  # periods that P_d is averaged over


def diagnose(
    scene: Scene | SceneFile,
    *,
    transient: int | None = None,
    steps_per_period: Steps | None = None,
    method: Method | Choices | None = None,
    accuracy: str | float | None = None,
    state: State | None = None,
    progress: Progress | None = None,
    throw: bool = False,
) -> Diagnosis:
    """The kind of motion that a scene settles on, the evidence for it, and all that a page shows of it.

    Return map, largest exponent and 0-1 test come from stretches of the run of their own, one after the other. Where
    they do not agree, or something still decays, the run goes on with stretches twice as long, at most twice. A motion
    is called periodic where Newton's method closes a stable orbit and the run stays at it; chaotic where the exponent
    is positive with its interval and K exceeds a half; quasi-periodic where the exponent is 0, surely, and K near 0.

    Args:
        scene: One scene, or a scene file, whose [run] counts where an argument is not given.
        transient: Drive periods run first; by default 64.
        steps_per_period: Runge-Kutta steps in one period; "auto": as many as it needs, as where only a method is given.
        method: How to march; where only steps are given RK4, with events located by the guard's cubic.
        accuracy: "fast", "balanced" (the default where nothing is said of steps or method), "reference" or a number:
            chooses steps and method, in float64.
        state: Where to start, at drive phase 0; by default `scene.initial`, apart.
        progress: Called with (periods done, periods at most) while the verdict is looked for.
        throw: Raise where the run stops, rather than warn.

    Returns:
        The diagnosis: `verdict`, `evidence`, `summary` and the samples; `plot()` draws the page.

    Raises:
        ValueError: There are many scenes, a count is too small, or float64 is not to be had.
        NumericalError: With `throw`: the run stopped.

    Source:
        Stroboscopic samples, periods and spectra as in Sec. 3.1 of the article; P_d by Eqs. (22) to (24).

    Example:
        >>> import jax; jax.config.update("jax_enable_x64", True)
        >>> import jaxshroud as js
        >>> scene = js.load("table1", ['parts.motion=["x"]', "blades.c_x=40"]).scene
        >>> js.diagnose(scene, steps_per_period=100).verdict
        'period 1'
    """
    one_scene("diagnose", scene)
    lanes = lanes_of(scene, transient=transient, steps_per_period=steps_per_period, method=method, accuracy=accuracy)
    how = lanes.how._replace(method=lanes.how.method._replace(ledger=True))
    ((ready, begun),) = lanes.begun(lanes.scenes, state)
    aim, before = Aim(how.steps, TOLERANCE[how.method.precision], how.method), lanes.asked.transient
    ticker = Ticker(before + (2**ROUNDS - 1) * Stretches().all, progress)
    (found,) = verdicts(alone(ready), alone(begun), before, aim, tick=ticker)
    stopped = found.kind == "stopped"
    marched: dict[str, Any] = {"steps_per_period": how.steps, "method": how.method}
    marched["state"] = begun if stopped else found.evidence.last
    repeats = ORBITS * found.q if found.q else OF_APERIODIC
    n_shown = found.periods if stopped else max(SHOWN, repeats)
    events = ready.parts.contact == "spring"
    run = simulate(scene, n_periods=n_shown, events=events and not stopped, throw=throw, **marched)
    more = {} if stopped else _more(scene, ready, found, how, marched)
    return _diagnosis(run, found, more)


def _more(
    scene: Scene | SceneFile, ready: Scene, found: Verdict, how: Marched, marched: dict[str, Any]
) -> dict[str, Any]:
    """Exponents of all directions and the convergence of P_d, of settled motion."""
    periods = SHOWN if found.q else OF_APERIODIC
    spectrum = alone_found(exponents(ready, found.evidence.last, periods, 0, how.steps, how.method))
    curve = power(scene, n_periods=POWER, transient=0, tolerance=1e-12, **marched)
    cycle = found.evidence.cycle if found.kind == "periodic" else None
    return {
        "exponents": spectrum.exponents,
        "exponents_ci": spectrum.ci,
        "multipliers": None if cycle is None or not cycle.sound else cycle.multipliers,
        "n": curve.n,
        "P_d": curve.P_d,
        "P_d_ci": curve.P_d_ci,
        "P_d_settled": int(curve.final["settled"]),  # files hold no truth values
    }


def _diagnosis(run: Trajectory, found: Verdict, more: dict[str, Any]) -> Diagnosis:
    """A run and what is known of it."""
    e = found.evidence
    told = {
        "verdict": found.words,
        "evidence": sentence(found),
        "period_number": found.q,
        "periods": found.periods,
        "return_error": e.error,
        "largest_exponent": e.exponent,
        "largest_exponent_ci": e.ci,
        "K": e.K,
    }
    known = Diagnosis.from_values({**told, "P_d_settled": 0, **more}).data
    whole = run.data.assign(known.data_vars).assign_attrs(known.attrs)
    if e.status != Status.OK and run.status == Status.OK:  # the verdict's march went further than the samples
        whole = whole.assign_attrs(status=int(np.int32(e.status)))
    return Diagnosis(whole)
