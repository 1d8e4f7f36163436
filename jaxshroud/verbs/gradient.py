"""Derivatives of the vibration-power reduction of a scene, or of many, and a check of them."""

from collections.abc import Sequence
from functools import partial

import numpy as np

from jaxshroud.batch.limits import check_size
from jaxshroud.batch.plan import Progress
from jaxshroud.batch.threads import Interrupted
from jaxshroud.linear.held_contact import LinearState, is_linear
from jaxshroud.march.method import FAST, FOR_P_D
from jaxshroud.model.prepared import State
from jaxshroud.orbits.batched_algorithms import run_together
from jaxshroud.orbits.gradient import (
    PowerGradient,
    Smoothing,
    differences_on,
    gradient_of,
    marched_levels,
)
from jaxshroud.orbits.linear_gradient import linear_gradient, linear_levels
from jaxshroud.orbits.orbit import PeriodicOrbit
from jaxshroud.results.gradient import Gradient
from jaxshroud.results.orbit import Orbit
from jaxshroud.scene.checks import InputError, count_argument, positive_argument, seed_argument
from jaxshroud.scene.drive_orders import check_continuous
from jaxshroud.scene.file import SceneFile
from jaxshroud.scene.quantities import Quantity, check_quantity, is_reduction
from jaxshroud.scene.scene import Scene
from jaxshroud.scene.typed import typed
from jaxshroud.scene.vary import level_of, numbers_that_count, with_numbers
from jaxshroud.signals.amplitudes import check_resonance, check_vibration, counted_reduction
from jaxshroud.verbs.arguments import MethodArgument, plan_march, resolve_options
from jaxshroud.verbs.lanes import check_row, results_of_all, warn_failed
from jaxshroud.verbs.orbit import cycles_of
from jaxshroud.verbs.settled import default_state, in_state, require_state


@typed
def gradient(
    scene: Scene | SceneFile,
    wrt: str | Sequence[str],
    *,
    of: Quantity | None = None,
    orbit: Orbit | None = None,
    linear: LinearState | None = None,
    sigma: float = 0.01,
    pairs: int = 128,
    seed: int = 0,
    most_periods: int = 512,
    n_periods: int | None = None,
    transient: int | None = None,
    method: MethodArgument = None,
    state: State | None = None,
    progress: Progress | None = None,
    throw: bool = False,
    dims: Sequence[str] | None = None,
) -> Gradient:
    """Gradient of P_d, of P, or of an amplitude, with respect to numbers of the scene.

    Where the scene settles on a periodic orbit, the gradient is exact, by the implicit function theorem. Elsewhere it
    is the gradient of the average over a normal distribution of the parameters around their values, with an interval.

    Args:
        scene: One scene, or many with leading axes, which then come first in all results; or a scene file, whose [run]
            counts where an argument is not given.
        wrt: Keys as for `vary`; without an index all blades, or interfaces, change together, by the same amount even
            where they differ. One blade of a row is named as in `row.mistuning[3]`. "all": every number on which the
            motion may depend; see `Gradient.effects`.
        of: The quantity to differentiate, by default P_d, and of a scene with a mean load or interference
            P_d_vibration: "P_d", "P", or an amplitude as `sweep` keeps them: "x_mean", "x_rms", "x_peak", and those of
            y and theta, "sigma_a", half the range of the stress of blades by modes, or "goodman", how much of its
            limits it uses. They are those of the left blade; of a row P_d and P are those of all blades together,
            "P_d_worst" is that of the blade that gains the least, and amplitudes are the largest.
        orbit: The orbit or orbits, if they are known already; their method is then the default.
        linear: "apart" or "stuck": in closed form, of contact that stays in this state; by default where it does,
            see `power`.
        sigma: Standard deviation of the distribution, relative to the value of each parameter.
        pairs: Antithetic pairs of samples; all samples start from the scene's initial state.
        seed: Seed of the samples.
        most_periods: Drive periods after which a motion that has not repeated is treated as aperiodic.
        n_periods: Drive periods kept for each sample; by default 64.
        transient: Drive periods run and discarded first for each sample; by default 64.
        method: How to march: a method, or the accuracy that chooses one; see `method_for`.
        state: Where to start, at drive phase 0: one state for all lanes, or one for each; by default `scene.initial`,
            apart.
        progress: Called with (lane-periods done, lane-periods at most) until the orbits are found.
        throw: Raise where a lane has no derivative, rather than warn.
        dims: Names of the leading axes; by default `lane`.

    Returns:
        The derivatives and their quality. A lane without one has NaN and a flag; the others are not affected. Where two
        extremes are as far from the mean, to 1e-6, and move differently, the derivative of a peak is that of one of
        them, with the flag "two peaks"; where two blades of a row are equally bad, "blades tie". A lane without a P_d,
        as its blades do not vibrate without contact or do so infinitely, has the flag "no P_d".

    Raises:
        KeyError: The scene has no such number.
        ValueError: There is no such `of`, the blades do not move in its coordinate, a count is too small, `sigma` is
            not positive, a smoothed derivative is requested with respect to a number that is 0, or `of` is a reduction
            of blades of which none vibrates without contact, or all do so infinitely.
        NumericalError: With `throw`, or for a single scene: the march stops in this scene or in nearly all of its
            neighbourhood.
        LinAlgError: With `throw`, or for a single scene: the equations of the orbit cannot be solved.

    Source:
        dP/dp = P_p + P_z (I - M)^-1 Phi_p for the fixed point z of the flow Phi over the orbit's periods.

    Example:
        >>> import jax; jax.config.update("jax_enable_x64", True)
        >>> import jaxshroud as js
        >>> scene = js.load("table1", ['parts.motion=["x"]', "blades.c_x=40"]).scene
        >>> found = js.gradient(scene, ["shroud.gap"], method=js.RungeKutta(steps=100))
        >>> found.kind, found.ci
        ('periodic', {'shroud.gap': 0.0})
    """
    seed_argument(seed)
    positive_argument("sigma", sigma)
    count_argument("most_periods", most_periods, 1)
    if orbit is not None and method is None:
        method = orbit.method
    if linear is None and state is None:
        linear = default_state(scene, method)
    resolved = resolve_options(
        in_state(scene, linear),
        n_periods=n_periods,
        transient=transient,
        method=method,
        dims=dims,
        verb="gradient",
    )
    check_row(resolved.scene)
    of = of or counted_reduction(resolved.scene)
    if isinstance(wrt, str):
        wrt = numbers_that_count(resolved.scene) if wrt == "all" else (wrt,)
    check_quantity(of, resolved.scene)
    _check_names(wrt, resolved.scene)
    require_state(resolved.lanes)
    if is_reduction(of):
        for check in (check_vibration, check_resonance):
            check(of, resolved.lanes, np.all)
    numbered = [with_numbers(one, wrt) for one in resolved.scenes]
    numbers = [[level_of(one, key) for key in wrt] for one in numbered]
    march = plan_march(resolved, resolved.lanes, FOR_P_D if is_reduction(of) else FAST, tangents=True)
    labels = resolved.labels(march)
    throw = throw or not resolved.shape
    if is_linear(resolved.scene):
        slopes = [linear_gradient(one, wrt, of, march.steps, march.method) for one in numbered]
        orbit = Orbit.of_cycles([slope.orbit for slope in slopes], resolved.shape, **labels)
        return warn_failed(Gradient.of_slopes(slopes, wrt, of, orbit, numbers, **labels), throw)
    if orbit is not None and np.shape(orbit.q) != resolved.shape:
        raise InputError(f"Argument `orbit` has lanes {np.shape(orbit.q)}, but the scene has {resolved.shape}.")
    plan = march.plan(resolved.transient, resolved.n_periods)
    smoothing = Smoothing(sigma, pairs, plan, seed)
    try:
        starts = resolved.with_states(numbered, state, march)
        cycles = orbit.cycles if orbit else cycles_of(starts, None, most_periods, march.shooting, progress, throw)
        if not all(cycle.sound or "stopped" in cycle.flags for cycle in cycles):
            count_argument("pairs", pairs, 2)
            check_size(2 * pairs, plan.transient, plan.kept)
        algorithms = [gradient_of(one, wrt, of, cycle, smoothing) for one, cycle in zip(numbered, cycles, strict=True)]
        slopes = results_of_all(lambda: run_together(algorithms), partial(_no_gradient, cycles, len(wrt)), throw)
    except Interrupted:
        raise Interrupted(None) from None
    orbit = orbit or Orbit.of_cycles(cycles, resolved.shape, **labels)
    return warn_failed(Gradient.of_slopes(slopes, wrt, of, orbit, numbers, **labels), throw)


def _no_gradient(cycles: list[PeriodicOrbit], size: int, lane: int, flag: str) -> PowerGradient:
    """The gradient of a lane that has none: NaN, with flags."""
    nan = np.full(size, np.nan)
    cycle = cycles[lane]
    flags = tuple(dict.fromkeys((*cycle.flags, flag)))
    return PowerGradient("none", nan, nan, np.nan, np.nan, cycle, np.nan, np.nan, flags)


def _check_names(wrt: Sequence[str], scene: Scene) -> None:
    if not len(wrt):
        raise InputError("Argument `wrt` must name at least one number of the scene.")
    for key in wrt:
        check_continuous(key, scene)


@typed
def differences(found: Orbit, wrt: Sequence[str], step: float, of: Quantity = "P_d") -> dict[str, float]:
    """Fourth-order central differences of `of` on orbits followed from scene to scene: a check of `gradient`.

    Args:
        found: The orbit of a single scene.
        wrt: Keys as for `gradient`.
        step: The step of the differences, relative to the value of each parameter, or absolute where that is 0.
        of: The quantity to differentiate.

    Returns:
        The derivative with respect to each key; NaN where a neighbouring orbit does not close.

    Raises:
        ValueError: There is no such `of`, no number is named, the step is not positive, or there are orbits of many
            scenes.

    Example:
        >>> import jax; jax.config.update("jax_enable_x64", True)
        >>> import jaxshroud as js
        >>> scene = js.load("table1", ['parts.motion=["x"]', "blades.c_x=40"]).scene
        >>> found = js.orbit(scene, method=js.RungeKutta(steps=100))
        >>> exact = js.gradient(scene, ["shroud.gap"], orbit=found).value["shroud.gap"]
        >>> abs(differences(found, ["shroud.gap"], 1e-4)["shroud.gap"] / exact - 1) < 1e-6
        True
    """
    positive_argument("step", step)
    cycle = found.cycle()
    _check_names(wrt, cycle.scene)
    check_quantity(of, cycle.scene)
    return differences_on(cycle, wrt, step, of, linear_levels if is_linear(cycle.scene) else marched_levels)
