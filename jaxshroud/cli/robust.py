"""What `tune` says of limits and of robustness."""

import numpy as np

from jaxshroud.results.tuned import Tuned

MILLI = 1e3


def told_limits(tuned: Tuned) -> dict[str, str]:
    """The largest force and penetration of any check, or draw, with what is left to their limits."""
    force = np.nanmax([*tuned.check_force, tuned.scattered_force or 0.0])
    deepest = np.nanmax([*tuned.check_v_max, tuned.scattered_v_max or 0.0])
    return {
        "largest normal force": _against(force, tuned.most_force, "N"),
        "largest penetration": _against(deepest * MILLI, tuned.most_penetration * MILLI, "mm"),
    }


def _against(value: float, limit: float, unit: str) -> str:
    if not np.isfinite(limit):
        return f"{value:.4g} {unit}, no limit"
    left = f"{1 - value / limit:.0%} left" if value <= limit else f"{value / limit - 1:.2%} too much"
    return f"{value:.4g} {unit} of {limit:.4g} {unit}: {left}"


def told_robustness(tuned: Tuned) -> dict[str, str]:
    """Tolerances, the probability of a wanted P_d, and coexisting motions."""
    if tuned.loss is None:
        return {}
    told = {f"up to {tuned.loss:g} points lost": "each number alone, in the worst condition; in SI units"}
    for key, one in tuned.intervals.items():
        ends = (f"{end:.5g} ({why})" for end, why in zip((one.low, one.high), one.ended_by, strict=True))
        told[f"  {key}"] = f"{' to '.join(ends)}, looked at every {one.apart:.2g}"
    if tuned.scatters:
        low, middle = np.nanquantile(tuned.sampled_P_d, (0.05, 0.5))
        told["P_d under the scatter"] = f"median {middle:.4g} %, one draw in twenty below {low:.4g} %"
    if tuned.at_least is not None:
        told[f"P_d at least {tuned.at_least:g} %"] = f"probability {tuned.chance}"
    return told | _motions(tuned)


def _motions(tuned: Tuned) -> dict[str, str]:
    if tuned.motions is None:
        return {}
    worst = int(np.nanargmin(tuned.motions_worst)) if np.isfinite(tuned.motions_worst).any() else 0
    count = ", ".join(map(str, tuned.motions))
    undecided = tuned.motions_undecided.max()
    left = f"; up to {undecided:.0%} of starts undecided" if undecided else ""
    own, least = tuned.nominal_P_d[worst], tuned.motions_worst[worst]
    return {"coexisting motions": f"{count}; the worst has a P_d of {least:.4g} % (from rest {own:.4g} %){left}"}
