"""States of contact as results hold them: of each interface, and of each point where its faces have several."""

from typing import TYPE_CHECKING, Any

import numpy as np

from jaxshroud.scene.keys import Motion

if TYPE_CHECKING:
    from jaxshroud.model.prepared import State

AT_POINTS = ("interface", "point")  # the dimensions of what is told of each point


def contact_values(state: "State", prefix: str = "") -> dict[str, Any]:
    """The slider, the mode and the case of a state by the names of results, which begin with a `prefix`."""
    from jaxshroud.model.points_contact import by_point, interface_mode

    mode, case, u_s = np.asarray(state.mode), np.asarray(state.case), np.asarray(state.u_s)
    if mode.ndim == case.ndim:
        told = {"u_s": u_s, "mode": mode, "case": case}
    else:
        of_face = np.asarray(interface_mode(by_point(mode, case)))
        told = {"mode": of_face, "case": case, "point_u_s": u_s, "point_mode": mode}
    return {f"{prefix}{name}": value for name, value in told.items()}


def stored_state(result: Any, motion: Motion, place: Any = ...) -> "State":
    """The state that a result holds under the names of `contact_values`, at a place of its arrays."""
    from jaxshroud.model.prepared import State

    u_s, mode = result.u_s, result.mode
    if result.point_mode is not None:
        u_s, mode = result.point_u_s, result.point_mode
    return State(motion, np.asarray(u_s)[place], np.asarray(mode)[place], np.asarray(result.case)[place])
