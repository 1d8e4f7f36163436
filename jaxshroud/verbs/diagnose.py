"""The kind of motion that one scene settles on, with the evidence for it."""

from functools import partial

from jaxshroud.batch.plan import Progress, Ticker
from jaxshroud.batch.xla import one_lane
from jaxshroud.march.method import FOR_P_D_WITH_LEDGER
from jaxshroud.model.modes import Status
from jaxshroud.model.prepared import State
from jaxshroud.motion.batched_algorithms import run_alone
from jaxshroud.motion.levels import is_comparable
from jaxshroud.motion.lyapunov import lyapunov_exponents
from jaxshroud.motion.shooting import CLOSING_TOLERANCE, ShootingOptions
from jaxshroud.motion.short_runs import end_states
from jaxshroud.motion.verdict import VERDICT_ROUNDS, Verdict, verdict_text, verdicts
from jaxshroud.motion.verdict_evidence import Stretches
from jaxshroud.results.diagnosis import Diagnosis
from jaxshroud.scene.file import SceneFile
from jaxshroud.scene.layout import PAIR
from jaxshroud.scene.scene import Scene
from jaxshroud.scene.typed import typed
from jaxshroud.verbs.accuracy import missed_lanes, warn_missed
from jaxshroud.verbs.asked import MarchPlan, MethodArgument
from jaxshroud.verbs.checks import check_row, one_scene
from jaxshroud.verbs.diagnose_row import JudgedMotion, motion_of_row
from jaxshroud.verbs.lanes import RequestedLanes, with_tangents
from jaxshroud.verbs.options import ResolvedOptions, resolve_options
from jaxshroud.verbs.power import power
from jaxshroud.verbs.simulate import simulate

MIN_STORED_PERIODS, APERIODIC_PERIODS = 64, 128  # stored periods, at least, and those of aperiodic motion
MIN_STORED_ORBITS = 4
POWER_PERIODS = 256  # over which P_d is averaged


@typed
def diagnose(
    scene: Scene | SceneFile,
    *,
    transient: int | None = None,
    method: MethodArgument = None,
    state: State | None = None,
    progress: Progress | None = None,
    throw: bool = False,
) -> Diagnosis:
    """The kind of motion that a scene settles on, the evidence for it, and the samples that show it.

    The return map, the largest exponent and the 0-1 test each have their own stretch of the run, one after the other.
    Where they do not agree, or something still decays, the run continues with stretches twice as long, at most twice. A
    motion is called periodic where Newton's method closes a stable orbit and the run stays on it; chaotic where the
    whole interval of the exponent is positive and K exceeds a half; quasi-periodic where the exponent is 0 within a
    narrow interval and K is near 0.

    Of a row of blades it tells whether the motion is a travelling wave, and the growth of a nearby run in place of
    exponents from tangents; there is no 0-1 test, and orbits are not closed by Newton's method.

    Args:
        scene: One scene, or a scene file, whose [run] counts where an argument is not given.
        transient: Drive periods run and discarded first; by default 64.
        method: How to march: a method, or the accuracy that chooses one; see `method_for`.
        state: Where to start, at drive phase 0; by default `scene.initial`, apart.
        progress: Called with (drive periods done, drive periods at most) until the verdict is found.
        throw: Raise where the run stops before its end, rather than warn.

    Returns:
        The diagnosis: `verdict`, `evidence`, `summary` and the samples; `plot()` draws the page.

    Raises:
        ValueError: There are many scenes, a count is too small, or JAX has no float64.
        NumericalError: With `throw`: the run stopped.

    Source:
        Stroboscopic samples, periods and spectra as in Sec. 3.1 of the article; P_d by Eqs. (22) to (24).

    Example:
        >>> import jax; jax.config.update("jax_enable_x64", True)
        >>> import jaxshroud as js
        >>> scene = js.load("table1", ['parts.motion=["x"]', "blades.c_x=40"]).scene
        >>> js.diagnose(scene, method=js.RungeKutta(steps=100)).verdict
        'period 1'
    """
    one_scene("diagnose", scene)
    resolved = resolve_options(scene, transient=transient, method=method, verb="diagnose")
    check_row(resolved.scene)
    judge = motion_of_pair if resolved.scene.layout == PAIR else motion_of_row
    found = judge(scene, resolved, state, progress)
    shown = {"n_periods": found.shown, "events": found.events, "method": found.method}
    run = simulate(scene, state=found.start, throw=throw, **shown)
    diagnosis = Diagnosis.from_values(found.told(run), layout=resolved.scene.layout).data
    data = run.data.assign(diagnosis.data_vars).assign_attrs(diagnosis.attrs)
    if found.status != Status.OK and run.status == Status.OK:  # the verdict's march went further than the samples
        data = data.assign_attrs(status=found.status)
    return Diagnosis(data)


def motion_of_pair(
    scene: Scene | SceneFile, resolved: ResolvedOptions, state: State | None, progress: Progress | None
) -> JudgedMotion:
    """The motion of a pair: by its returns, the exponent of a tangent, the 0-1 test and Newton's method."""
    march = with_tangents(resolved, resolved.lanes, FOR_P_D_WITH_LEDGER)
    march = march._replace(method=march.method._replace(ledger=True))
    ((precise, initial),) = RequestedLanes(resolved, march).with_states(resolved.scenes, state)
    shooting = ShootingOptions(march.steps, CLOSING_TOLERANCE[march.method.precision], march.method)
    ticker = Ticker(resolved.transient + (2**VERDICT_ROUNDS - 1) * Stretches().all, progress)
    (verdict,) = verdicts(one_lane(precise), one_lane(initial), resolved.transient, shooting, tick=ticker)
    if march.tried is not None:
        ends = partial(end_states, ledger=True, vibration=True)  # by the programs of the verdict
        warn_missed(missed_lanes(resolved.lanes, march.tried, ends), march.tried)
    stopped = verdict.kind == "stopped"
    shown = MIN_STORED_ORBITS * verdict.q if verdict.q else APERIODIC_PERIODS
    settled = {} if stopped else _settled_evidence(scene, precise, verdict, march)
    return JudgedMotion(
        int(verdict.evidence.status),
        initial if stopped else verdict.evidence.last,
        verdict.periods if stopped else max(MIN_STORED_PERIODS, shown),
        precise.parts.contact == "spring" and not stopped,
        march.untried.again,
        lambda _: _verdict_values(verdict) | settled,
    )


def _settled_evidence(
    scene: Scene | SceneFile, precise: Scene, verdict: Verdict, march: MarchPlan
) -> dict[str, object]:
    """The exponents of all directions, the multipliers and the convergence of P_d of the settled motion."""
    periods, settled = MIN_STORED_PERIODS if verdict.q else APERIODIC_PERIODS, verdict.evidence.last
    spectrum = run_alone(lyapunov_exponents(precise, settled, periods, 0, march.steps, march.method))
    same_march = march.untried.again
    cycle = verdict.evidence.cycle if verdict.kind == "periodic" else None
    known = {
        "exponents": spectrum.exponents,
        "exponents_ci": spectrum.ci,
        "slider_stuck": int(spectrum.stuck),
        "multipliers": None if cycle is None or not cycle.sound else cycle.multipliers,
    }
    if not is_comparable("P_d", precise):
        return known
    curve = power(scene, n_periods=POWER_PERIODS, transient=0, stable_within=1e-12, method=same_march, state=settled)
    settled_number = int(curve.final["settled"])  # files cannot hold booleans
    alone = {name: float(curve.final[name]) for name in ("P_d_vibration", "P_d_vibration_ci")}
    return {**known, **alone, "n": curve.n, "P_d": curve.P_d, "P_d_ci": curve.P_d_ci, "P_d_settled": settled_number}


def _verdict_values(verdict: Verdict) -> dict[str, object]:
    """The verdict and its first evidence, by the names of `Diagnosis`."""
    evidence = verdict.evidence
    return {
        "verdict": verdict.words,
        "evidence": verdict_text(verdict),
        "period_number": verdict.q,
        "periods": verdict.periods,
        "return_error": evidence.error,
        "largest_exponent": evidence.exponent,
        "largest_exponent_ci": evidence.ci,
        "K": evidence.K,
        "P_d_settled": 0,
        "slider_stuck": 0,
    }
