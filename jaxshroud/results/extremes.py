"""What matters most in a sweep, in words: the largest amplitude, the smallest P_d, and blocks that move too far."""

import tomllib
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import numpy as np

from jaxshroud.io.scene_numbers import layout_in
from jaxshroud.model.modes import Status
from jaxshroud.scene.keys import parse_key
from jaxshroud.scene.layout import Layout
from jaxshroud.scene.quantities import amplitude_of, free_name, unit_of
from jaxshroud.scene.title import display_value
from jaxshroud.scene.units import in_rpm
from jaxshroud.signals.effects import with_interval
from jaxshroud.signals.period import NOT_SETTLED, UNKNOWN_IF_SETTLED

if TYPE_CHECKING:
    import xarray as xr

EQUAL_BLADES = 1e-6  # relative distance of amplitudes of blades that count as one
MOST_NAMED = 6  # blades
SHOWN_DIGITS = 3
TRANSIENTS = {NOT_SETTLED: ", transient not over", UNKNOWN_IF_SETTLED: ", transient perhaps not over"}
STARTS = {"independent": "from rest", "forward": "swept forward", "backward": "swept backward"}
SIDES = {"x": "shroud.l_oa", "y": "shroud.l_ab"}  # of a block
Place = Mapping[str, float]  # of a lane in a sweep: key -> value [SI]


class Swept(Protocol):
    """What is read of a sweep here, beside the amplitudes and reductions that are requested by name."""

    data: "xr.Dataset"

    @property
    def status(self) -> Any:
        """How each lane has ended."""
        ...

    @property
    def settling(self) -> Any:
        """The verdict on each lane's transient."""
        ...

    @property
    def coexisting(self) -> Any:
        """Where motions coexist; None where that was not looked for."""
        ...

    @property
    def axes(self) -> dict[str, np.ndarray]:
        """Key -> values in SI units."""
        ...


class ExtremeAmplitude(NamedTuple):
    """The largest amplitude of the lanes of a sweep, beside the largest one without contact."""

    of: str  # such as x_peak
    value: float  # [m or rad]
    place: Place
    blades: tuple[str, ...]  # the names of those that have it
    settling: int  # the verdict on the transient
    direction: str  # of the sweep, where motions coexist there; else empty
    free: float  # without contact [m or rad]
    free_place: Place
    layout: Layout

    @property
    def name(self) -> str:
        """What it is the largest of, in words."""
        amplitude = amplitude_of(self.of)
        assert amplitude is not None  # `of` is no power
        return f"largest {'amplitude' if amplitude.measure == 'peak' else 'RMS'} of {amplitude.displacement}"

    @property
    def words(self) -> str:
        """The amplitudes with their places, in the units of pictures."""
        who = ", ".join(filter(None, (blade_words(self.blades, self.layout), STARTS.get(self.direction))))
        with_contact = f"{amplitude_words(self.of, self.value)}{place_words(self.place)} ({who})"
        without = f"{amplitude_words(self.of, self.free)}{place_words(self.free_place)}"
        return f"{with_contact}{TRANSIENTS.get(self.settling, '')}; without contact {without}"

    def numbers(self) -> dict[str, Any]:
        """The same as `summary.json` holds it."""
        unit = f"amplitude [{unit_of(self.of)}]"
        return {
            "words": self.words,
            unit: self.value,
            **place_numbers(self.place),
            "blades": list(self.blades),
            "settled": self.settling not in TRANSIENTS,
            "without contact": {unit: self.free, **place_numbers(self.free_place)},
        }


def largest_amplitude(swept: Swept, of: str, counting: slice = slice(None)) -> ExtremeAmplitude | None:
    """The largest amplitude of the lanes of a sweep that have come to their end; None where there is none.

    Args:
        swept: The sweep, with amplitudes.
        of: The amplitude, e.g. "x_peak".
        counting: The blades that count.
    """
    levels = np.where((swept.status == Status.OK)[..., None], getattr(swept, of)[..., counting], np.nan)
    free = getattr(swept, free_name(of))[..., counting]
    if not np.nanmax(levels, initial=0.0) > 0:
        return None
    lane = lane_of(np.nanmax(np.nan_to_num(levels, nan=-np.inf), axis=-1))
    free_lane = lane_of(np.nan_to_num(free, nan=-np.inf, posinf=np.inf).max(axis=-1))
    layout = layout_in(swept.data)
    return ExtremeAmplitude(
        of=of,
        value=float(np.nanmax(levels[lane])),
        place=lane_place(swept, lane),
        blades=tuple(layout.names[i] for i in largest_blades(levels[lane])),
        settling=int(swept.settling[lane]),
        direction=_direction(swept, lane),
        free=float(np.nanmax(free[free_lane])),
        free_place=lane_place(swept, free_lane) if free[free_lane].any() else {},
        layout=layout,
    )


def largest_blades(levels: np.ndarray) -> list[int]:
    """The blades whose amplitude (blades,) is the largest."""
    return np.flatnonzero(levels >= (1 - EQUAL_BLADES) * levels.max()).tolist()


def smallest_reduction(swept: Swept, name: str) -> dict[str, Any] | None:
    """The smallest reduction of power of the lanes that have come to their end, as `summary.json` holds it.

    It is None where there is none. That contact makes it worse is said where the vibration about the mean is larger
    than without contact, by more than its interval.

    Args:
        swept: The sweep.
        name: The reduction, such as "P_d".
    """
    values = np.where(swept.status == Status.OK, getattr(swept, name), np.nan)
    values = np.where(np.isfinite(values), values, np.inf)
    if not np.isfinite(values).any():
        return None
    lane = lane_of(-values)
    ci = float(getattr(swept, f"{name}_ci")[lane])
    place = lane_place(swept, lane)
    worse = ": contact makes it worse" if _is_worse(swept, lane) else ""
    number = with_interval(float(values[lane]), ci, "%")
    transient = TRANSIENTS.get(int(swept.settling[lane]), "")
    return {
        "words": f"{number}{place_words(place)}{transient}{worse}",
        name: float(values[lane]),
        "ci": ci,
        **place_numbers(place),
        "contact makes it worse": bool(worse),
    }


def _is_worse(swept: Swept, lane: tuple[int, ...]) -> bool:
    """Whether a lane vibrates more than without contact, by more than its interval."""
    names = [name for name in ("P_d", "P_d_vibration") if getattr(swept, name) is not None]
    return all(getattr(swept, name)[lane] + getattr(swept, f"{name}_ci")[lane] < 0 for name in names)


def passed_sides(swept: Swept) -> Iterator[str]:
    """A line for each displacement whose amplitude passes the side of a block."""
    for name, key in SIDES.items():
        peaks = getattr(swept, f"{name}_peak")
        side = _number_of_lanes(swept, key)
        if peaks is None or side is None:
            continue
        levels = np.where(swept.status == Status.OK, np.nanmax(peaks, axis=-1, initial=0.0), 0.0)
        lane = lane_of(levels / side)
        if levels[lane] > side[lane]:
            moved = f"{amplitude_words(f'{name}_peak', float(levels[lane]))}{place_words(lane_place(swept, lane))}"
            beyond = f"more than the block's side of {_shown(key, float(side[lane]))}"
            yield f"the amplitude of {name} is {moved}, {beyond}: the model is of small displacements, see `check`"


def _number_of_lanes(swept: Swept, key: str) -> np.ndarray | None:
    """A number of the scene of each lane; None where it is not known."""
    status = swept.data["status"]
    for variable in swept.data.variables.values():
        if variable.attrs.get("key") == key:
            return variable.set_dims(status.sizes).to_numpy()
    table, _, name = key.partition(".")
    value = tomllib.loads(str(swept.data.attrs.get("scene", ""))).get(table, {}).get(name)
    return None if value is None else np.full(status.shape, float(value))


def lane_of(levels: np.ndarray) -> tuple[int, ...]:
    """The indices of the largest level."""
    return tuple(map(int, np.unravel_index(np.argmax(levels), levels.shape)))


def lane_place(swept: Swept, lane: tuple[Any, ...]) -> Place:
    """Where a lane is in a sweep."""
    at = lane[len(lane) - len(swept.axes) :]
    return {key: float(values[i]) for (key, values), i in zip(swept.axes.items(), at, strict=True)}


def _direction(swept: Swept, lane: tuple[int, ...]) -> str:
    """The direction of a lane where its value has several motions; else empty."""
    if swept.coexisting is None or not swept.coexisting[lane[1:]]:
        return ""
    return str(swept.data["direction"].to_numpy()[lane[0]])


def place_numbers(place: Place) -> dict[str, float]:
    """A place as `summary.json` holds it: in SI units, a speed in rpm."""
    speed = {"drive.speed [rpm]": in_rpm(place["drive.speed"])} if "drive.speed" in place else {}
    return {key: value for key, value in place.items() if key != "drive.speed"} | speed


def place_words(place: Place) -> str:
    """A place in the units of pictures: " at 1750 rpm", or " at contact.gamma = 2"; empty for no place."""
    texts = {key: display_value(*parse_key(key)[0].parts, value) for key, value in place.items()}
    is_clear = len(place) == 1 and all(parse_key(key)[0].shown[0] for key in place)
    shown = texts.values() if is_clear else [f"{key} = {text}" for key, text in texts.items()]
    return f" at {', '.join(shown)}" if place else ""


def amplitude_words(of: str, value: float) -> str:
    """An amplitude in the unit of pictures."""
    return _shown(f"initial.{of.partition('_')[0]}", value)


def _shown(key: str, value: float) -> str:
    unit, per_si = parse_key(key)[0].shown
    return f"{per_si * value:.{SHOWN_DIGITS}g} {unit}" if np.isfinite(value) else "without bound"


def blade_words(names: tuple[str, ...], layout: Layout) -> str:
    """Blades by their names: "left blade", "blade 12", "blades 2 and 4 others", or all of them."""
    if len(names) == layout.blades:
        return layout.number_words
    if not layout.interface_shape:
        return f"{names[0]} blade"
    if len(names) > MOST_NAMED:
        return f"blade {names[0]} and {len(names) - 1} others"
    return f"blade{'s' * (len(names) > 1)} {', '.join(names)}"
