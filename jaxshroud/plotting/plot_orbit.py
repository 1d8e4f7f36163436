"""Pictures of the multipliers of a periodic orbit and of the Lyapunov exponents of a motion."""

from typing import NamedTuple

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from jaxshroud.plotting.page import Page, Panel
from jaxshroud.plotting.style import BLUE, GREY, INK, ORANGE, PAGE_WIDTH, TIGHT_LEGEND, Appearance, fitting_title
from jaxshroud.scene.typed import FloatArray

NEUTRAL = 1e-9  # distance from 1 at which a multiplier is a free slider's own
LEAST_MAGNITUDE = 1e-16  # of a multiplier whose magnitude is drawn: smaller ones are rounding, or forgotten
MOST_CURVES = 4  # exponents of which the averages are drawn
LABEL_DISTANCE = 0.06  # of labels, over the height of the panel
MANY = "many scenes: choose one of them by `lane`"


class MultiplierData(NamedTuple):
    """The multipliers of one orbit."""

    of_period: np.ndarray  # complex, largest first
    of_wave: np.ndarray | None  # of the reduced map of a travelling wave


def orbit_page(ds: xr.Dataset, appearance: Appearance) -> Page[MultiplierData]:
    """The multipliers of an orbit of a single scene.

    Args:
        ds: An `Orbit` of one scene.
        appearance: The requested appearance.
    """
    title = fitting_title(str(ds.attrs.get("title", "")))
    size = (PAGE_WIDTH, 3.0)
    if "status" not in ds.attrs:
        return Page(None, (), title, size, nothing=MANY)
    if not int(ds.attrs["q"]):
        return Page(None, (), title, size, nothing="no periodic orbit was found")

    def complex_of(name):
        return ds[f"{name}_real"].to_numpy() + 1j * ds[f"{name}_imag"].to_numpy()

    reduced = complex_of("wave_multipliers") if ds.attrs.get("wave_parts") else None
    return Page(MultiplierData(complex_of("multipliers"), reduced), ORBIT_PANELS, title, size, columns=2)


def _draw_plane(panel: Axes, data: MultiplierData) -> None:
    """The multipliers in the complex plane; those outside the unit circle are unstable."""
    around = np.exp(2j * np.pi * np.linspace(0, 1, 200))
    panel.plot(np.real(around), np.imag(around), color=GREY, lw=0.8)
    for values, marker, label in _sets(data):
        outside = np.abs(values) > 1
        for where, color in ((~outside, BLUE), (outside, ORANGE)):
            shown = values[where]
            panel.plot(np.real(shown), np.imag(shown), marker, color=color, ms=4, mew=1, mfc="none")
        panel.plot([], [], marker, color=INK, ms=4, mew=1, mfc="none", label=label)
    extent = 1.15 * max(1.0, max(float(np.abs(values).max()) for values, *_ in _sets(data)))
    panel.set(xlim=(-extent, extent), ylim=(-extent, extent), aspect="equal")
    panel.set(xlabel="real part", ylabel="imaginary part", title="Floquet multipliers")
    if data.of_wave is not None:
        panel.legend(loc="upper right", **TIGHT_LEGEND)


def _draw_magnitudes(panel: Axes, data: MultiplierData) -> None:
    """The magnitudes in order: how much of a push is left after the orbit's period; what is forgotten is left out."""
    panel.axhline(1, color=GREY, lw=0.8)
    for values, marker, label in _sets(data):
        size = np.sort(np.abs(values))[::-1]
        size = size[: max(int((size > LEAST_MAGNITUDE).sum()), 1)]
        panel.semilogy(np.arange(1, len(size) + 1), size, marker, color=BLUE, ms=4, mew=1, mfc="none", label=label)
    panel.set(xlabel="direction", ylabel="magnitude", title="what is left of a push")
    panel.xaxis.set_major_locator(MaxNLocator(integer=True))


def _sets(data: MultiplierData) -> list[tuple[np.ndarray, str, str]]:
    """The multipliers that are shown, with their markers and names."""
    sets = [(data.of_period, "o", "of the period")]
    return sets if data.of_wave is None else [*sets, (data.of_wave, "x", "of the travelling wave")]


ORBIT_PANELS = (Panel("multipliers", _draw_plane), Panel("magnitudes", _draw_magnitudes))


class ExponentData(NamedTuple):
    """The Lyapunov exponents of one scene."""

    exponents: FloatArray  # per drive period, largest first; -inf: forgotten, NaN: not resolved
    ci: FloatArray
    growth: FloatArray  # (periods, exponents)

    @property
    def finite(self) -> np.ndarray:
        """The indices of those that are numbers."""
        return np.flatnonzero(np.isfinite(self.exponents))


def lyapunov_page(ds: xr.Dataset, appearance: Appearance) -> Page[ExponentData]:
    """The Lyapunov exponents of a single scene.

    Args:
        ds: A `Lyapunov` of one scene.
        appearance: The requested appearance.
    """
    title = fitting_title(str(ds.attrs.get("title", "")))
    size = (PAGE_WIDTH, 2.8)
    if "status" not in ds.attrs:
        return Page(None, (), title, size, nothing=MANY)
    content = ExponentData._make(ds[name].to_numpy() for name in ("exponents", "ci", "growth"))
    if not len(content.finite):
        return Page(None, (), title, size, nothing="no exponent is a number")
    return Page(content, LYAPUNOV_PANELS, title, size, columns=2)


def _draw_exponents(panel: Axes, data: ExponentData) -> None:
    """All exponents with their intervals; arrows point to those of directions that are forgotten altogether."""
    finite = data.finite
    panel.axhline(0, color=GREY, lw=0.8)
    halves = np.nan_to_num(data.ci[finite])
    panel.errorbar(finite + 1, data.exponents[finite], halves, fmt="o", color=BLUE, ms=3, capsize=2)
    lost = np.flatnonzero(np.isneginf(data.exponents))
    low = panel.get_ylim()[0]
    if len(lost):
        panel.plot(lost + 1, np.full(len(lost), low), "v", color=INK, ms=5, label="forgotten: $-\\infty$")
        panel.legend(loc="best", **TIGHT_LEGEND)
    panel.set(xlabel="direction", ylabel="exponent per drive period", title="Lyapunov exponents")
    panel.xaxis.set_major_locator(MaxNLocator(integer=True))


def _draw_averages(panel: Axes, data: ExponentData) -> None:
    """The averages of the largest exponents over the first periods."""
    shown = data.finite[:MOST_CURVES]
    n = np.arange(1, len(data.growth) + 1)
    panel.axhline(0, color=GREY, lw=0.8)
    averages = np.cumsum(data.growth[:, shown], axis=0) / n[:, None]
    for average, alpha in zip(averages.T, np.linspace(1, 0.35, MOST_CURVES), strict=False):
        panel.semilogx(n, average, color=BLUE, lw=0.9, alpha=alpha)
    panel.set(xlabel="periods averaged over", ylabel="exponent per drive period", title="the largest, by direction")
    panel.set(xlim=(1, max(len(n), 2)))
    for value, names in _labels(averages[-1], shown + 1, LABEL_DISTANCE * float(np.ptp(panel.get_ylim()))):
        place = {"transform": panel.get_yaxis_transform(), "va": "center", "fontsize": "small"}
        panel.text(1.02, value, names, **place)


def _labels(values: FloatArray, names: np.ndarray, apart: float) -> list[tuple[float, str]]:
    """Where the names of curves are written, largest value first; near ones share a place."""
    groups: list[tuple[float, list[str]]] = []
    for i in np.argsort(-values):
        if groups and groups[-1][0] - values[i] < apart:
            groups[-1][1].append(str(names[i]))
        else:
            groups.append((float(values[i]), [str(names[i])]))
    return [(value, ", ".join(group)) for value, group in groups]


LYAPUNOV_PANELS = (Panel("exponents", _draw_exponents), Panel("averages", _draw_averages))
