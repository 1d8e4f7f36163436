"""The amplitudes of motions, the loads of contact and its states, as results hold them."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxshroud.io.variable import Variable
from jaxshroud.scene.keys import Motion, parse_key
from jaxshroud.signals.effects import with_interval

if TYPE_CHECKING:
    from jaxshroud.model.prepared import State

MEAN, RMS = "mean of {}", "root mean square of {} about its mean"
RMS_CI = "half width of the 95 % interval of {}, batch means"
PEAK = (
    "amplitude of {}: its largest distance from its mean, between steps too; "
    "of an aperiodic motion the largest of the kept periods"
)
FREE = "amplitude of {} without contact, closed form"
FREE_RMS = "root mean square of {} about its mean without contact, closed form"
EACH = ("interface",)
AT_POINTS = ("interface", "point")  # the dimensions of quantities of each point
OF_MODES = ("order", "of_mode", "blade")  # the coordinates of modes, and their rates
ENERGY_DROPPED = "largest energy dropped in a period by beginnings of flat contact, over the drive's gross work"


class WithAmplitudes:
    """Amplitudes of x, y and theta of both blades over the kept periods, in results of runs with `amplitudes`."""

    x_mean = Variable(MEAN.format("x"), "m", ("blade",))
    x_rms = Variable(RMS.format("x"), "m", ("blade",))
    x_rms_ci = Variable(RMS_CI.format("x_rms"), "m", ("blade",))
    x_peak = Variable(PEAK.format("x"), "m", ("blade",))
    x_free = Variable(FREE.format("x"), "m", ("blade",))
    x_free_rms = Variable(FREE_RMS.format("x"), "m", ("blade",))
    y_mean = Variable(MEAN.format("y"), "m", ("blade",))
    y_rms = Variable(RMS.format("y"), "m", ("blade",))
    y_rms_ci = Variable(RMS_CI.format("y_rms"), "m", ("blade",))
    y_peak = Variable(PEAK.format("y"), "m", ("blade",))
    y_free = Variable(FREE.format("y"), "m", ("blade",))
    y_free_rms = Variable(FREE_RMS.format("y"), "m", ("blade",))
    theta_mean = Variable(MEAN.format("theta"), "rad", ("blade",))
    theta_rms = Variable(RMS.format("theta"), "rad", ("blade",))
    theta_rms_ci = Variable(RMS_CI.format("theta_rms"), "rad", ("blade",))
    theta_peak = Variable(PEAK.format("theta"), "rad", ("blade",))
    theta_free = Variable(FREE.format("theta"), "rad", ("blade",))
    theta_free_rms = Variable(FREE_RMS.format("theta"), "rad", ("blade",))
    sigma_a = Variable("half the range of the stress over whole orbits", "Pa", ("blade",))
    sigma_m = Variable("middle of that range", "Pa", ("blade",))
    goodman = Variable(
        "utilisation by Goodman: sigma_a / sigma_e + max(sigma_m + sigma_0, 0) / sigma_u", "1", ("blade",)
    )


class WithLoads:
    """The loads of contact over the latest whole orbits of the kept periods, in results of runs with `forces`.

    Of a row they are those of each interface.
    """

    N_max = Variable("largest normal force of contact", "N", EACH)
    F_max = Variable("largest magnitude of the friction force", "N", EACH)
    N_mean = Variable("mean normal force, the time apart included", "N", EACH)
    N_slip = Variable("mean normal force while the faces slip; NaN if they do not", "N", EACH)
    friction_work = Variable("work that friction takes in a drive period, on average", "J", EACH)
    slip = Variable("path of the slider on the face in a drive period, on average; NaN for own laws", "m", EACH)
    archard = Variable("integral of N |u_s'| over a drive period, on average: friction work / mu", "J", EACH)
    impacts = Variable("contacts that begin from a gap in a drive period, on average", "1", EACH)
    approach_max = Variable("largest closing speed of an impact; 0 without any", "m s-1", EACH)
    approach_mean = Variable("mean closing speed of impacts; NaN without any", "m s-1", EACH)
    impulse_max = Variable("largest impulse of the normal force in one contact; 0 if none ends", "N s", EACH)
    impulse_mean = Variable("mean impulse of the normal force of the contacts that end; NaN if none does", "N s", EACH)


def load_numbers(result: Any, ok: np.ndarray) -> dict[str, float]:
    """The largest forces and the largest work of friction of all lanes, if they were kept."""
    forces = {
        "largest normal force [N]": result.N_max,
        "largest friction force [N]": result.F_max,
        "largest work of friction per period [J]": result.friction_work,
        "largest slip per period [m]": result.slip,
        "largest closing speed of an impact [m/s]": result.approach_max,
        "largest impulse of a contact [N s]": result.impulse_max,
    }
    return largest_of_lanes(ok, forces)


def amplitude_numbers(result: Any, ok: np.ndarray, aperiodic: np.ndarray, periods: int) -> dict[str, Any]:
    """The largest amplitudes of all lanes, and the largest root mean squares with intervals, if they were kept.

    Args:
        result: The result.
        ok: Which lanes came to their end.
        aperiodic: Which lanes have no period.
        periods: Over how many periods amplitudes are taken.
    """
    peaks = {"x [m]": result.x_peak, "y [m]": result.y_peak, "theta [rad]": result.theta_peak}
    rows = largest_of_lanes(ok, {f"largest amplitude of {name}": a for name, a in peaks.items()})
    if rows and np.any(ok & aperiodic):
        rows |= {"amplitudes of aperiodic motions": f"the largest of {periods} periods"}
    return rows | _largest_rms(result, ok)


def _largest_rms(result: Any, ok: np.ndarray) -> dict[str, str]:
    """The largest root mean square of each displacement that moves, with its interval, of any blade in lanes OK."""
    rows = {}
    for name in ("x", "y", "theta"):
        rms, ci = getattr(result, f"{name}_rms"), getattr(result, f"{name}_rms_ci")
        if rms is None or ci is None:
            continue
        counted = np.where(np.reshape(ok, (*np.shape(ok), 1)) & np.isfinite(rms), rms, 0.0)
        if counted.any():
            at = np.unravel_index(np.argmax(counted), counted.shape)
            unit, per_si = parse_key(f"initial.{name}")[0].shown
            rows[f"largest RMS of {name}"] = with_interval(per_si * float(rms[at]), per_si * float(ci[at]), unit)
    return rows


def largest_of_lanes(ok: np.ndarray, quantities: Mapping[str, np.ndarray | None]) -> dict[str, float]:
    """The largest value of each quantity that was kept, of any blade or interface in the lanes that are OK."""

    def counted(a):
        return np.reshape(ok, np.shape(ok) + (1,) * (np.ndim(a) - np.ndim(ok)))

    return {name: float(np.max(a, where=counted(a), initial=0.0)) for name, a in quantities.items() if a is not None}


def contact_values(state: "State", prefix: str = "") -> dict[str, Any]:
    """The contact of a state by the names of results, which begin with a `prefix`, and the coordinates of modes."""
    from jaxshroud.model.points_contact import by_point, interface_mode

    mode, case, u_s = np.asarray(state.mode), np.asarray(state.case), np.asarray(state.u_s)
    if mode.ndim == case.ndim:
        rows = {"u_s": u_s, "mode": mode, "case": case}
    else:
        of_face = np.asarray(interface_mode(by_point(mode, case)))
        rows = {"mode": of_face, "case": case, "point_u_s": u_s, "point_mode": mode}
    if not isinstance(state.motion, Motion):
        rows["modal"] = np.stack([np.stack(part, axis=-2) for part in state.motion], axis=-3)
    return {f"{prefix}{name}": value for name, value in rows.items()}


def stored_state(result: Any, motion: Motion, place: Any = ...) -> "State":
    """The state that a result holds under the names of `contact_values`, at a place of its arrays."""
    from jaxshroud.batch.lanes import modal_motion
    from jaxshroud.model.prepared import State

    own = motion if result.modal is None else modal_motion(result.modal[place])
    u_s, mode = result.u_s, result.mode
    if result.point_mode is not None:
        u_s, mode = result.point_u_s, result.point_mode
    return State(own, np.asarray(u_s)[place], np.asarray(mode)[place], np.asarray(result.case)[place])
