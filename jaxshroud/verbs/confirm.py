"""Whether the lanes of a sweep end on the motion on which a finer march ends."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from jaxshroud.batch.threads import Interrupted
from jaxshroud.model.modes import Status
from jaxshroud.results.sweep import SweepResult
from jaxshroud.verbs.sweep_run import SweepSettings

SAME_P_D = 1e-3  # percentage points beside both intervals: more than the rounding of a settled orbit makes


def confirmed_run(run: Callable[[SweepSettings], SweepResult], settings: SweepSettings) -> SweepResult:
    """A sweep, with `unconfirmed` where it is to be confirmed: run again with half the step and a tenth the tolerance.

    Raises:
        Interrupted: Ctrl-C; `done` is without `unconfirmed` where the sweep itself had ended.
    """
    result = run(settings)
    if not settings.confirm:
        return result
    try:
        finer = run(_finer_settings(settings))
    except Interrupted:
        raise Interrupted(result) from None
    variable = SweepResult.variables["unconfirmed"]
    entries = variable.entries(_ends_elsewhere(result, finer), result.dims)
    return SweepResult(result.data.assign(dict(entries)))


def _finer_settings(settings: SweepSettings) -> SweepSettings:
    plan = settings.plan
    finer = replace(plan, steps_per_period=2 * plan.steps_per_period, method=plan.method.finer)
    return settings._replace(plan=finer, march=settings.march.untried, confirms=True)


def _ends_elsewhere(result: SweepResult, finer: SweepResult) -> np.ndarray:
    """Whether lanes whose P_d has settled have another period number or P_d by the finer march."""
    both_ran = (result.status == Status.OK) & (finer.status == Status.OK)
    apart = np.abs(result.P_d - finer.P_d) > SAME_P_D + result.P_d_ci + finer.P_d_ci
    return both_ran & result.P_d_settled & (apart | (result.period_number != finer.period_number))
