"""What of a scene depends on the speed of its rotor: stiffnesses that grow with it, and gaps that untwist changes.

    k(Omega) = k + B m Omega^2,    gap(Omega) = gap + (gap_at - gap) (Omega / Omega_at)^2,    Omega = omega / e

with the engine order e of the drive, that of omega itself. Mistuning, frequencies and damping ratios by which a scene
is given, and gamma, refer to the stiffness at rest; dampers stay as they are.
"""

from collections.abc import Container, Iterable, Mapping
from typing import Any

import numpy as np

from jaxshroud.scene.checks import KeyNameError, SceneError, fail, toml_text
from jaxshroud.scene.keys import MAX_MODES
from jaxshroud.scene.units import is_speed_of_rotation

ORDER = "drive.engine_order"
# (k, m) of each growth B: k(Omega) = k + B m Omega^2
GROWTHS = {"blades.B_x": ("k_x", "m"), "blades.B_y": ("k_y", "m_y"), "blades.B_T": ("k_T", "I")}
MODE_GROWTHS = {f"blades.modes[{j}].B": f"blades.modes[{j}].f" for j in range(MAX_MODES)}  # of omega^2
UNTWIST = ("shroud.gap_at", "shroud.gap_at_speed")
SPEED_KEYS = (*GROWTHS, *MODE_GROWTHS, UNTWIST[0])


def depends_on_speed(numbers: Container[str]) -> bool:
    """Whether a scene with these numbers has any that changes another with the speed."""
    return any(key in numbers for key in SPEED_KEYS)


def keys_in(document: Mapping[str, Any]) -> list[str]:
    """The keys that the tables of a file have."""
    return [f"{table}.{name}" for table, rows in document.items() if isinstance(rows, Mapping) for name in rows]


def needed_order(numbers: Container[str], given: Mapping[str, Any]) -> dict[str, Any]:
    """The engine order by which a scene with these numbers and inputs gives its speed, if anything depends on that."""
    return {ORDER: given[ORDER]} if ORDER in given and depends_on_speed(numbers) else {}


def grown(k: Any, B: Any, mass: Any, square: Any) -> Any:
    """A stiffness at the square of a speed [rad^2/s^2]; without B as it is."""
    return k if B is None else k + B * mass * square


def untwisted_gap(gap: Any, at: Any, share: Any) -> Any:
    """The gap [m] by the one `at` another speed, of whose square the square of the speed is a share."""
    return gap + (at - gap) * share


def check_is_no_speed(where: str, key: str, value: Any, engine_order: Any) -> None:
    """Refuse a speed of rotation for the circular frequency of a drive whose scene has an engine order."""
    if key == "drive.omega" and engine_order is not None and is_speed_of_rotation(value):
        order = f"{engine_order:g}" if isinstance(engine_order, int | float) else engine_order
        fail(
            where,
            f"{toml_text(value)} is a speed of rotation, but omega is the frequency of a drive with engine order "
            f"{order}; name drive.speed, or give omega in rad/s",
        )


def without_zeros(entries: Mapping[str, Any]) -> dict[str, Any]:
    """The entries of a table without a growth with the speed that is 0, which changes nothing."""
    growths = {key.partition(".")[2] for key in (*GROWTHS, *MODE_GROWTHS)}
    return {name: value for name, value in entries.items() if name not in growths or np.any(value)}


def engine_order_of(scene: object) -> float | None:
    """The engine order by which a scene is given; None where only the frequency of its drive is known."""
    order = getattr(scene, "given", {}).get("drive.engine_order")
    return None if order is None else float(order)


def check_speed(numbers: Mapping[str, Any], given: Mapping[str, Any], blades: int, where: str = "") -> None:
    """Raise a SceneError, which begins with `where`, unless what depends on the speed of a scene can be worked out.

    Args:
        numbers: The numbers of the scene, or of many, by their keys.
        given: Its inputs.
        blades: How many blades there are.
        where: The place that the message names first.
    """
    where = f"{where}: " if where else ""
    for key, other in (UNTWIST, UNTWIST[::-1]):
        if key in numbers and other not in numbers:
            raise SceneError(f"{where}{key} needs {other}: give both, the gap at a speed and that speed")
    key = next((key for key in SPEED_KEYS if key in numbers), None)
    if key is None:
        return
    if given.get(ORDER) is None:
        raise SceneError(f"{where}{key} needs {ORDER}, by which the speed is omega / engine_order; give it in its file")
    order = np.asarray(given[ORDER], float)
    if np.any(order == 0):
        raise SceneError(f"{where}{key} needs a speed, but {ORDER} = 0 gives none")
    square = (np.asarray(numbers["drive.omega"], float) / order) ** 2
    for key, (k, mass) in GROWTHS.items():
        if key in numbers:
            inertia = numbers.get(f"blades.{mass}", numbers["blades.m"])
            _check_growth(key, k, (numbers[f"blades.{k}"], inertia), numbers, square, blades, where)
    for key, f in MODE_GROWTHS.items():
        if key in numbers:
            omega = 2 * np.pi * np.asarray(numbers[f], float)
            _check_growth(key, "omega^2", (omega**2, 1.0), numbers, square, blades, where)


def _check_growth(
    key: str, k: str, own: tuple[Any, Any], numbers: Mapping[str, Any], square: Any, blades: int, where: str
) -> None:
    """Raise a SceneError if a stiffness, `own` with its mass at rest, is not positive at a speed."""
    each = [np.asarray(a, float) for a in (own[0], numbers[key], own[1])]
    at_rest, B, inertia = (a if a.ndim > square.ndim else np.repeat(a[..., None], blades, -1) for a in each)
    at_rest = at_rest * (1 + np.asarray(numbers.get("row.mistuning", 0.0), float))
    at_speed = grown(at_rest, B, inertia, square[..., None])
    if np.all(at_speed > 0):
        return
    place = np.unravel_index(np.argmin(at_speed), at_speed.shape)
    speed = float(np.sqrt(np.broadcast_to(square[..., None], at_speed.shape)[place])) * 30 / np.pi
    raise SceneError(
        f"{where}{key} = {float(np.broadcast_to(B, at_speed.shape)[place]):g} makes {k} negative at {speed:.4g} rpm "
        f"({float(at_speed[place]):.4g}); give a larger one, or stay at lower speeds"
    )


def require_phases_of_order(name: str, others: Container[str], numbers: Container[str], where: str = "") -> None:
    """Raise a KeyNameError where other phases would take from a row the engine order that its speed needs.

    Args:
        name: The number that is replaced.
        others: The keys of which it takes the place.
        numbers: The numbers of the scene by their keys.
        where: The place that the message names first.
    """
    where = f"{where}: " if where else ""
    if name == "drive.phase" and ORDER in others and depends_on_speed(numbers):
        raise KeyNameError(
            f"{where}drive.phase is that of {ORDER} in a row whose stiffness or gap depends on its speed; "
            "name drive.harmonic[0].phase for one with a list of harmonics"
        )


def replaced_by(key: str, others: Iterable[str], numbers: Container[str]) -> list[str]:
    """Those of the `others` that `key` replaces: not an engine order that gives the speed beside a frequency."""
    beside = {ORDER} if key != ORDER else {"drive.omega", "drive.f"}
    return [other for other in others if not (other in beside and depends_on_speed(numbers))]
