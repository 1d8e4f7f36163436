"""A stored run made ready for pictures: what is finite of it, in the pictures' units, and its last periods."""

from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from jaxshroud.model.modes import Mode
from jaxshroud.motion.spectrum import repeats_after
from jaxshroud.results.drawing import Floats
from jaxshroud.results.instants import with_events
from jaxshroud.results.panels import Scale, scale_of
from jaxshroud.scene.errors import InputError

CONTACT = ("N", "F", "v", "u", "contact_point", "mode", "case")
FEWEST = 20  # samples of a period in which contact can be seen
APERIODIC = 4  # drive periods shown of a motion that does not repeat

Integers = NDArray[np.integer[Any]]
Booleans = NDArray[np.bool_]


@dataclass(frozen=True)
class Drawn:
    """A run in the units of the picture."""

    ds: xr.Dataset  # of which nothing else is drawn
    scale: Scale
    t: Floats  # [drive periods]
    x: Floats  # (n, 2)
    v: Floats  # of the left blade [m/s]
    mode: Integers
    kept: Booleans  # after the transient
    ends: Booleans  # of these, the ends of periods
    rate: Fraction  # samples in a period

    @cached_property
    def repeats(self) -> int:
        """After how many drive periods the motion repeats; 0 where it does not."""
        return repeats_after(self.x[self.kept, 0], self.rate)


def drawn(ds: xr.Dataset, settled_from: float = 0.5, scale: Scale | None = None) -> Drawn | None:
    """What is finite of a run, if anything is.

    Args:
        ds: A stored run of a single scene. What lies after its first value that is not finite is left out.
        settled_from: The share of the run that counts as its transient.
        scale: Of displacements; by default over the gap, or in mm where that is not positive.
    """
    bad = ~np.isfinite(ds["x"].to_numpy() + ds["v_x"].to_numpy()).all(axis=1)
    ds = ds.isel(time=slice(0, int(bad.argmax()) if bad.any() else None))
    if ds.sizes["time"] < 2:
        return None
    scale, steps = scale or scale_of(np.asarray(ds.attrs["gap"])), int(ds.attrs["steps_per_period"])
    t = _periods(ds, ds["time"].to_numpy())
    kept = t > t[0] + settled_from * (t[-1] - t[0]) + 1e-9  # not the sample that ends the transient
    ends = kept & (np.rint(t * steps) % steps == 0)
    x, v = ds["x"].to_numpy() * scale.factor, ds["v_x"].to_numpy()[:, 0]
    return Drawn(ds, scale, t, x, v, ds["mode"].to_numpy(), kept, ends, Fraction(steps, int(ds.attrs["every"])))


def _periods(ds: xr.Dataset, time: Floats) -> Floats:
    return time * float(ds.attrs["omega"]) / (2 * np.pi)


class Touching(NamedTuple):
    """What contact does over the last drive periods of a run, both sides of events included where they are stored."""

    t: Floats  # since these began [drive periods]
    N: Floats  # [N]
    F: Floats
    v: Floats  # [m]
    u: Floats
    contact_point: Floats | None
    mode: Integers
    case: Integers

    @property
    def stretches(self) -> list[slice]:
        """Stretches in one mode and one case."""
        changed = (np.diff(self.mode) != 0) | (np.diff(self.case) != 0)
        ends = [0, *(np.flatnonzero(changed) + 1).tolist(), len(self.t)]
        return [slice(a, b) for a, b in pairwise(ends)]

    @property
    def pieces(self) -> list[slice]:
        """The same, each up to the next one's first state: but not across events of which both sides are known."""
        of, t = self.stretches, self.t
        bridged = [s.stop < len(t) and t[s.stop] > t[s.stop - 1] for s in of]
        return [slice(s.start, s.stop + bridge) for s, bridge in zip(of, bridged, strict=True)]


def touching(run: Drawn, periods: int | None = None) -> Touching:
    """What contact does over the last whole drive periods.

    Args:
        run: The run.
        periods: How many of them; by default those after which the motion repeats, or four.

    Raises:
        ValueError: The run was stored without forces, has no contact, or has too few samples.
    """
    ds = run.ds
    if "N" not in ds.data_vars:
        model = 'contact = "none"' in str(ds.attrs.get("scene", ""))
        why = "its model has no contact" if model else "it was stored by an earlier version; simulate it again"
        raise InputError(f"There are no forces in this run: {why}.")
    if run.rate < FEWEST:
        raise InputError(
            f"{float(run.rate):.3g} samples of a period are stored, too few to show contact; keep every "
            f"{max(int(ds.attrs['steps_per_period']) // FEWEST, 1)}th step at most."
        )
    names = [name for name in CONTACT if name in ds.data_vars]
    whole, (begin, end) = with_events(ds, names), _last(run.t, periods or run.repeats or APERIODIC)
    t = _periods(ds, whole["time"].to_numpy())
    at = (t > begin - 1e-9) & (t < end + 1e-9)
    values = {name: whole[name].to_numpy()[at] for name in names}
    if (values["mode"] == Mode.SMOOTH).all():  # which has no modes of its own
        values["mode"] = np.where(values["v"] < 0, Mode.APART, Mode.SMOOTH)
    return Touching(t[at] - begin, contact_point=values.pop("contact_point", None), **values)


def _last(t: Floats, periods: int) -> tuple[float, float]:
    """Beginning and end of the last whole drive periods; of the whole run where it is shorter than one."""
    end = np.floor(t[-1] + 1e-9)
    whole = int(end - t[0] + 1e-9)
    return (end - min(periods, whole), end) if whole else (t[0], t[-1])
