"""The response of a scene over one of its numbers, e.g. its frequency response: sweeps, branches and peaks.

A peak with contact stands against the peak without: at one speed a contact that only shifts the resonance away looks
like one that damps it; the peaks compare resonances.
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, cast

import jax
import numpy as np
from jaxtyping import ArrayLike

from jaxshroud.batch.closed_form import linear_amplitude_values
from jaxshroud.batch.plan import Progress
from jaxshroud.linear.held_contact import LinearState, is_linear
from jaxshroud.march.method import FOR_P_D
from jaxshroud.march.method_names import RESPONSES
from jaxshroud.orbits.peaks import AmplitudesAt, branch_peaks, linear_peaks
from jaxshroud.results.branch import Branch
from jaxshroud.results.response import Member, Response
from jaxshroud.results.sweep import SweepResult
from jaxshroud.scene.checks import InputError, NumericalError, count_argument, word_argument
from jaxshroud.scene.file import SceneFile
from jaxshroud.scene.grids import scenes_at
from jaxshroud.scene.keys import find_key
from jaxshroud.scene.layout import Layout
from jaxshroud.scene.quantities import Quantity, counted_amplitude, free_name
from jaxshroud.scene.scene import Scene
from jaxshroud.scene.sector import smallest_ring
from jaxshroud.scene.typed import typed
from jaxshroud.scene.vary import value_of, vary, with_numbers
from jaxshroud.signals.amplitudes import counted_reduction, free_amplitudes
from jaxshroud.verbs.arguments import MethodArgument, plan_march, resolve_options
from jaxshroud.verbs.branch import BranchStart, continued, range_of
from jaxshroud.verbs.lanes import check_row, one_scene
from jaxshroud.verbs.settled import default_state, in_state
from jaxshroud.verbs.sweep import sweep

FREE_LOOKS = (2001, *[65] * 5)  # values at which the free amplitude is looked at, then ever more closely
VALUES, ZOOMS, MARGIN = 61, 2, 2  # of the sweeps with contact; a closer look goes this many values beyond the largest


class PeakOfSweep(NamedTuple):
    """The largest value of an amplitude over a range of a number."""

    value: float  # of the number [SI]
    amplitude: float
    at_end: bool  # it is at an end of the range: the peak may lie beyond


class PeakRatio(NamedTuple):
    """The peaks of an amplitude with and without contact."""

    of: str
    along: str
    ends: tuple[float, float]  # of the range [SI]
    apart: float  # distance between neighbouring values of the last look
    free: PeakOfSweep
    contact: PeakOfSweep

    @property
    def words(self) -> str:
        """The peaks and their ratio in words."""
        unit, per_si = find_key(self.along)[0].shown
        ends, at, free = ([f"{per_si * v:.6g}" for v in vs] for vs in (self.ends, [self.contact[0]], [self.free[0]]))
        beyond = [
            f" The largest {kind} contact is at an end of the range: the peak may lie beyond."
            for kind, peak in (("without", self.free), ("with", self.contact))
            if peak.at_end
        ]
        share = self.contact.amplitude / self.free.amplitude
        return (
            f"Peak against peak, over {self.along} from {' to '.join(ends)} {unit}: the largest {self.of} with contact "
            f"is {self.contact.amplitude:.5g} m, at {at[0]} {unit} (upwards, downwards and from rest, every "
            f"{per_si * self.apart:.2g} {unit} there), without contact {self.free.amplitude:.5g} m, at {free[0]} "
            f"{unit}; the first is {share:.4g} of the second.{''.join(beyond)}"
        )


def peak_ratio(scene: Scene, along: str, low: float, high: float, of: str, run: Mapping[str, Any]) -> PeakRatio | None:
    """The peaks of an amplitude with and without contact; None where no run comes to its end.

    It is the largest of the blades that count.

    The sweeps go over the range, then about their largest value once more, with the same number of values.

    Args:
        scene: One scene.
        along: The number, as for `vary`.
        low: One end of its range [SI].
        high: The other end.
        of: The amplitude, e.g. "x_peak".
        run: The arguments of `sweep` that say how to run.
    """
    ends = (low, high)
    values = np.linspace(low, high, VALUES)
    apart = np.nan
    found = []
    for _ in range(ZOOMS):
        swept = sweep(scene, {along: values}, direction="both", amplitudes=True, **run)
        levels = counted_amplitude(getattr(swept, of), scene.layout)
        if not np.isfinite(levels).any():
            break
        top = int(np.unravel_index(np.nanargmax(levels), levels.shape)[-1])
        found.append((float(np.nanmax(levels)), float(values[top])))
        apart = float(values[1] - values[0])
        beside = MARGIN * apart
        values = np.linspace(max(values[top] - beside, low), min(values[top] + beside, high), VALUES)
    if not found:
        return None
    level, value = max(found)
    return PeakRatio(of, along, ends, apart, free_peak(scene, along, low, high, of), _peak_in(value, level, ends))


def _peak_in(value: float, level: float, ends: tuple[float, float]) -> PeakOfSweep:
    return PeakOfSweep(value, level, value in ends)


def free_peak(scene: Scene, along: str, low: float, high: float, of: str) -> PeakOfSweep:
    """Where an amplitude without contact is largest in a range of a number, and that amplitude."""
    names = (of.partition("_")[0],)
    numbered = with_numbers(scene, [along])
    values = np.array([low, high])
    at = low
    level = 0.0
    for count in FREE_LOOKS:
        values = np.linspace(values[0], values[-1], count)
        ring, _ = smallest_ring(scenes_at(numbered, [along], values[:, None]))
        every = free_amplitudes(ring, names)
        levels = counted_amplitude(every[free_name(of)], ring.layout)
        top = int(levels.argmax())
        at = float(values[top])
        level = float(levels[top])
        values = values[max(top - 1, 0) : top + 2]
    return _peak_in(at, level, (low, high))


MOST_POINTS = 4_000  # of a branch in one direction, if it goes on to the ends of its range
MAX_TRIED_PLACES = 4  # at which an orbit to begin with is sought
WAVE_SPREAD = 1e-3  # of the largest amplitude: blades of a travelling wave that has settled differ by less


@typed
def response(
    scene: Scene | SceneFile,
    along: str = "drive.omega",
    start: float | None = None,
    stop: float | None = None,
    *,
    num: int = 200,
    of: str = "x_peak",
    over: Mapping[str, ArrayLike | Sequence[float]] | None = None,
    at: float | None = None,
    linear: LinearState | None = None,
    most_points: int | None = None,
    doublings: int | None = None,
    n_periods: int | None = None,
    transient: int | None = None,
    method: MethodArgument = None,
    progress: Progress | None = None,
) -> Response:
    """An amplitude over one number of a scene, by default over the drive frequency.

    The scene is swept forward, backward and from rest, and the orbit that it settles on is followed along the number,
    past folds, stable or not. Along that branch the peaks of the amplitude are placed, with their width at half power.
    The amplitude of a row is that of the blade that swings most; travelling waves of a ring of alike blades are
    followed, and the broken waves that begin where their shift breaks, see `branch`.

    Args:
        scene: One scene, or a scene file, whose [run] and [sweep] count where an argument is not given.
        along: The number, as for `vary`, e.g. "drive.omega" or "drive.speed".
        start: One end of its range, in SI units.
        stop: The other end.
        num: Values of the sweeps.
        of: The amplitude whose peaks are sought, of the left blade of a pair or of the blade of a row that swings
            most: "x_peak", "x_rms", "y_peak" and so on.
        over: A second number with its values: a family of responses.
        at: The value at which the branch begins; by default where the sweep from rest has settled on an
            orbit, as near to the scene's own value as there is one; of a ring one on which all blades swing alike.
        linear: "apart" or "stuck": in closed form, of contact that stays in this state; by default where that of all
            values and peaks does, see `power`. There is no branch then, and peaks are placed between the ends of the
            range.
        most_points: Largest number of points of a branch in one direction; by default the branch goes on until its
            range ends, to four thousand points at most.
        doublings: How many times in succession orbits of twice the period are followed from flips, and broken waves
            of a ring from localisation; by default 0, of rows 1.
        n_periods: Drive periods kept of each value of the sweeps; by default 64.
        transient: Drive periods run and discarded first; by default 64.
        method: How to march: a method, or the accuracy that chooses one for all parts, by both ends of the range; see
            `method_for`.
        progress: Called with (lane-periods done, lane-periods in all) of each part; the latter is 0 while it is
            not known.

    Returns:
        The sweeps, the branches where there is a periodic orbit to begin with, and the peaks.
        Branches that are not connected to the one followed are not found, but the sweeps may show their motions.

    Raises:
        KeyError: The scene has no such number.
        ValueError: The range is empty, a count is too small, or there is no such amplitude.
        Interrupted: Ctrl-C.

    Source:
        At half power the amplitude is 1 / sqrt(2) of its peak; the width there over twice the frequency of the peak is
        the damping ratio of a lightly damped linear oscillator.

    Example:
        >>> import jax; jax.config.update("jax_enable_x64", True)
        >>> import jaxshroud as js
        >>> scene = js.load("table1", ['parts.motion=["x"]', "blades.c_x=40"]).scene
        >>> short = dict(num=4, n_periods=4, transient=4, method=js.RungeKutta(steps=100))
        >>> js.response(scene, "contact.gamma", 2.0, 3.0, **short).status.shape
        (1, 3, 4)
    """
    count_argument("num", num, 2)
    count_argument("doublings", doublings or 0, 0)
    count_argument("most_points", MOST_POINTS if most_points is None else most_points, 2)
    word_argument("of", of, RESPONSES)
    scene = in_state(scene, linear)
    low, high = range_of(scene, along, start, stop)
    family = {} if over is None else {key: np.atleast_1d(np.asarray(values, float)) for key, values in over.items()}
    if len(family) > 1 or along in family:
        raise InputError("Argument `over` must be one number, and another one than `along`.")
    if not all(values.size for values in family.values()):
        raise InputError("Argument `over` needs at least one value of its number.")
    plain = one_scene("response", scene)
    check_row(plain)
    changes = [(key, float(v)) for key, values in family.items() for v in values] or [None]
    scenes = [plain if change is None else vary(with_numbers(plain, [change[0]]), *change) for change in changes]
    values = np.linspace(low, high, num)
    if linear is None and at is None:
        linear = _default_state(scenes, along, values, of, method)
        scene = in_state(scene, linear)
        scenes = [in_state(one, linear) for one in scenes]
    resolved = resolve_options(scene, n_periods=n_periods, transient=transient, method=method, of_sweep=True)
    ends = [scenes_at(with_numbers(one, [along]), [along], np.array([[low], [high]])) for one in scenes]
    whole = 3 * num * (resolved.transient + resolved.n_periods)  # of a member
    march = plan_march(resolved, jax.tree.map(lambda *a: np.concatenate(a), *ends), FOR_P_D, periods=whole / 2)
    run = {"n_periods": resolved.n_periods, "transient": resolved.transient, "method": march.again}
    in_succession = int(plain.row is not None) if doublings is None else doublings
    sizes = (most_points or MOST_POINTS, in_succession)
    members = [_member(one, along, values, of, at, sizes, run, progress) for one in scenes]
    attributes, _ = resolved.provenance(march.steps)
    return Response.of_members(members, along, of, family, counted_reduction(plain), attributes)


def _member(
    scene: Scene,
    along: str,
    values: np.ndarray,
    of: str,
    at: float | None,
    sizes: tuple[int, int],
    run: dict,
    progress: Progress | None,
) -> Member:
    """The response of one scene."""
    low, high = float(values[0]), float(values[-1])
    swept = sweep(scene, {along: values}, direction="both", amplitudes=True, progress=progress, **run)
    free = free_peak(scene, along, low, high, of)[:2]
    if is_linear(scene):
        return _linear_member(scene, along, values, of, swept, free)
    own = value_of(with_numbers(scene, [along]), along)
    reason = "no lane from rest settles on a periodic orbit"
    for place in _places(swept, values, own, scene.layout) if at is None else [at]:
        try:
            found = continued(
                scene, along, (low, high), BranchStart(place), *sizes, method=run["method"], progress=progress
            )
        except NumericalError as error:
            reason = str(error)
            continue
        branch = Branch.of_branches(found.branches, along, (low, high), found.attributes)
        return Member(swept, branch, branch_peaks(found.problem, found.branches, of), free, "")
    return Member(swept, None, [], free, reason)


def _default_state(
    scenes: list[Scene], along: str, values: np.ndarray, of: str, method: MethodArgument
) -> LinearState | None:
    """The state that the contact of all members keeps at all values and peaks; None where it is to march."""

    def state_at(scene: Scene, at: np.ndarray) -> LinearState | None:
        return default_state(scenes_at(with_numbers(scene, [along]), [along], at[:, None]), method)

    state = state_at(scenes[0], values)
    if state is None or any(state_at(one, values) != state for one in scenes[1:]):
        return None
    for one in scenes:
        peaks = linear_peaks(_linear_amplitudes(in_state(one, state), along, of), values, one.layout)
        tops = np.array([peak.value for peak in peaks])
        if len(tops) and state_at(one, tops) != state:
            return None
    return state


def _linear_amplitudes(scene: Scene, along: str, of: str) -> AmplitudesAt:
    """The amplitudes of a scene whose contact stays in one state, at values of a number."""
    numbered = with_numbers(scene, [along])
    quantity = cast(Quantity, of)
    return lambda at: linear_amplitude_values(scenes_at(numbered, [along], at[:, None]), quantity)


def _linear_member(
    scene: Scene, along: str, values: np.ndarray, of: str, swept: SweepResult, free: tuple[float, float]
) -> Member:
    """The response of a scene whose contact stays in one state."""
    peaks = linear_peaks(_linear_amplitudes(scene, along, of), values, scene.layout)
    return Member(swept, None, peaks, free, f"a closed form of contact that stays {scene.parts.contact} has no branch")


def _places(swept: SweepResult, values: np.ndarray, own: float, layout: Layout) -> list[float]:
    """Where the branch may begin: values at which the sweep from rest has an orbit, settled and short ones first.

    Of rows those on which all blades swing alike are before others: a travelling wave, from which broken ones begin.
    """
    lanes = swept.data.sel(direction="independent")
    number = lanes["period_number"].to_numpy()
    settled = lanes["settled"].to_numpy() == 1
    unlike = _is_broken(lanes["x_rms"].to_numpy()[:, layout.counting])

    def rank(i):
        return (number[i] == 0, not settled[i], unlike[i], number[i], abs(values[i] - own))

    order = sorted(range(len(values)), key=rank)
    return [float(values[i]) for i in order[:MAX_TRIED_PLACES]]


def _is_broken(amplitude: np.ndarray) -> np.ndarray:
    """Whether amplitudes (values, blades) differ from blade to blade."""
    return np.ptp(amplitude, axis=1) > WAVE_SPREAD * amplitude.max(axis=1)
