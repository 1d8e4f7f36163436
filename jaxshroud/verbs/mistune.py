"""The Monte Carlo of mistuned rows: how much larger the largest amplitude is than that of the tuned row."""

import os
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import ArrayLike

from jaxshroud.batch.plan import Progress
from jaxshroud.linear.natural_modes import NaturalContact
from jaxshroud.march.method import FOR_P_D
from jaxshroud.march.method_names import RESPONSES
from jaxshroud.results.mistuned import QUANTILE_SHARES, Mistuned, mistuned_coordinates
from jaxshroud.scene.checks import InputError, count_argument, seed_argument, word_argument
from jaxshroud.scene.file import SceneFile
from jaxshroud.scene.grids import grid_of_scenes, scenes_at
from jaxshroud.scene.layout import SINGLE_DIRECTIONS, Direction
from jaxshroud.scene.mistuning import NO_PATTERN, mistuned_designs, random_patterns
from jaxshroud.scene.scene import Scene
from jaxshroud.scene.sector import asks_for_sector, whole_ring
from jaxshroud.scene.typed import FloatArray, typed
from jaxshroud.scene.vary import vary, with_numbers
from jaxshroud.signals.amplitudes import check_vibration
from jaxshroud.signals.statistics import quantile_interval
from jaxshroud.signals.waves import RowResponses, largest_amplitudes
from jaxshroud.verbs.arguments import MethodArgument, ResolvedOptions, plan_march, resolve_options
from jaxshroud.verbs.lanes import flatten_lanes, one_scene, refuse_traced
from jaxshroud.verbs.linear_rows import linear_problem
from jaxshroud.verbs.mistuned_rows import (
    MistunedRow,
    PatternProblem,
    SearchSize,
    marched_problem,
    search_worst_pattern,
    tuned_and_mistuned_responses,
    with_patterns,
)


@typed
def mistune(
    scene: Scene | SceneFile,
    along: Mapping[str, ArrayLike | Sequence[float]] | None = None,
    *,
    sigmas: Sequence[float] = (0.03,),
    n_patterns: int = 100,
    designs: Sequence[str] = (NO_PATTERN,),
    of: str = "x_peak",
    direction: Direction = "independent",
    linear: NaturalContact | None = None,
    scan: int = 32,
    starts: int = 4,
    updates: int = 0,
    seed: int = 0,
    store: str | os.PathLike[str] | None = None,
    resume: bool = False,
    n_periods: int | None = None,
    transient: int | None = None,
    method: MethodArgument = None,
    progress: Progress | None = None,
) -> Mistuned:
    """The amplification of rows with random patterns of mistuning, with quantiles and their intervals.

    The amplification is the largest amplitude over that of the tuned row, each the largest over all blades, all values
    of a number such as the speed, and all directions in which these are taken.

    Args:
        scene: A row of blades, or a scene file of one, whose [run] and [sweep] count where an argument is not given.
            Its own mistuning is left out. With `row.sector` = "auto" the tuned row is marched by its sector, and those
            with patterns whole.
        along: One key as for `vary`, such as "drive.speed" or "drive.omega", with values (n,) in SI units that
            increase: the range that holds the resonances. None: that of the file.
        sigmas: Standard deviations of the relative deviations of k_x, k_y and k_T of each blade, one or more.
        n_patterns: Random patterns, the same for all sigmas and designs: each is sigma times standard normal numbers.
        designs: Intentional patterns about which the random ones are drawn: "none", "alternate:0.02" (0.02, -0.02, ...)
            and "harmonic:3:0.02" (0.02 cos(2 pi 3 i / N) at blade i).
        of: The amplitude that counts: "x_peak", "x_rms", "y_peak" and so on.
        direction: "independent": every lane starts from `scene.initial`. "forward" or "backward": each value starts
            from the final state of its neighbour, up or down the range. "both": all three. See `sweep`.
        linear: One state of contact in which all interfaces stay: "apart", "sliding", "stuck" or "corner", see `check`.
            The row is linear then, its response to all harmonics of the drive is in closed form, and the peak between
            two values counts too. None: rows are marched with all their events; a row without contact is apart.
        scan: Random patterns that are tried first in the search for the worst pattern.
        starts: The best of them, from which paths begin.
        updates: Steps of each path up the gradient; 0: no search. Patterns of the search have a root mean square of at
            most the largest sigma. Slopes of rows with contact are differences, from rest.
        seed: Seed of the patterns; the first of them is the scene's own of that seed.
        store: The folder (.zarr) of a store of the sweep of all patterns, for runs that may be killed.
        resume: Continue the store if it exists; a search begins anew.
        n_periods: Drive periods kept, over which amplitudes are taken; by default 64.
        transient: Drive periods run and discarded first; by default 64.
        method: How to march: a method, or the accuracy that chooses one; see `method_for`.
        progress: Called with (lane-periods done, lane-periods in all).

    Returns:
        Amplitudes and amplifications of all patterns, quantiles of the amplification, and what a search has found. A
        pattern of which any lane stopped has no amplification, and is left out of the quantiles.

    Raises:
        KeyError: The scene has no such number.
        ValueError: The scene is no row, values do not increase, a pattern does not fit the row or makes a stiffness
            negative, the row does not move as asked, or a search is to continue from value to value.
        StoreError: See `sweep`.
        Interrupted: Ctrl-C; a store has the blocks that had ended.

    Source:
        Whitehead's factor: with one mode per blade a linear row amplifies by (1 + sqrt(N)) / 2 at most.

    Example:
        >>> import jax; jax.config.update("jax_enable_x64", True)
        >>> import jaxshroud as js
        >>> ring = js.load("row_ring12", ['parts.motion=["x"]'])
        >>> speeds = {"drive.omega": [1100.0, 1200.0, 1300.0, 1400.0]}
        >>> js.mistune(ring, speeds, linear="stuck", n_patterns=20).amplification.shape
        (1, 1, 20)
    """
    resolved = resolve_options(
        scene, n_periods=n_periods, transient=transient, method=method, of_sweep=True, verb="mistune"
    )
    row = _mistuned_row(scene, along, of)
    _check_driven(row)
    linear = _state_of_contact(row, linear, direction)
    size = search_size(scan, starts, updates, linear, direction)
    patterns = _patterns_of(row, designs, sigmas, n_patterns, seed)
    if linear is not None:
        responses, run = _in_closed_form(row, patterns, linear, size, resolved, progress)
    else:
        responses, run = _marched(row, patterns, direction, size, (store, resume), resolved, progress)
    drawn = _Drawn(tuple(designs), np.asarray(sigmas, float), patterns, responses)
    values = _monte_carlo(row, drawn) | run.attributes
    if size is not None:
        values |= _search_values(row, run.problem, size, float(max(sigmas)), seed, values["tuned_largest"])
    values |= {"of": of, "along": row.along, "linear": linear or "", "direction_of": direction, "seed": seed}
    steps = int(run.attributes["steps_per_period"])
    attrs, _ = resolved._replace(scene=row.by_sector or row.scene).provenance(steps)
    ways = SINGLE_DIRECTIONS if direction == "both" else (direction,)
    coords = mistuned_coordinates(row.along, row.values, drawn.designs, drawn.sigmas, ways, patterns.shape[1])
    return Mistuned.from_values(values, coords=coords, attrs=attrs)


class _Run(NamedTuple):
    """How patterns are run in a search, and the attributes of the result that say so."""

    problem: PatternProblem
    attributes: dict[str, Any]


class _Drawn(NamedTuple):
    """Patterns and their responses: the tuned row, the designs without a random part, and all random patterns."""

    designs: tuple[str, ...]
    sigmas: FloatArray
    patterns: FloatArray  # (1 + designs + designs * sigmas * n, N)
    responses: RowResponses


def _mistuned_row(scene: Scene | SceneFile, along: Mapping[str, Any] | None, of: str) -> MistunedRow:
    """The row without mistuning, and its axis, from the arguments of `mistune`."""
    word_argument("of", of, RESPONSES)
    if along is None and isinstance(scene, SceneFile):
        along = {axis.key: axis.values for axis in scene.axes}
    one = one_scene("mistune", scene)
    if of.split("_")[0] not in one.parts.motion:
        raise InputError(f"Argument `of` is {of}, but the blades of this scene move in {', '.join(one.parts.motion)}.")
    refuse_traced(along)
    axes = {key: np.atleast_1d(np.asarray(values, float)) for key, values in (along or {}).items()}
    if len(axes) != 1 or any(v.ndim != 1 or v.size < 2 or np.any(np.diff(v) <= 0) for v in axes.values()):
        raise InputError("Argument `along` must name one key with at least two values that increase.")
    ((key, values),) = axes.items()
    with_numbers(one, [key])
    tuned = vary(one, "row.mistuning", np.zeros(one.layout.blades))
    return MistunedRow(whole_ring(tuned), key, values, of, tuned if asks_for_sector(tuned) else None)


def _check_driven(row: MistunedRow) -> None:
    """Raise an InputError for a row that nothing drives, whatever the value."""
    numbered = with_numbers(row.scene, [row.along])
    check_vibration(row.of, scenes_at(numbered, [row.along], row.values[:, None]), np.all)


def _state_of_contact(row: MistunedRow, linear: NaturalContact | None, direction: Direction) -> NaturalContact | None:
    """The state of contact of a linear row; None: it is marched."""
    if direction != "independent" and (linear is not None or row.scene.parts.contact == "none"):
        raise InputError(f'A linear row has one motion at each value, and no direction "{direction}"; leave it out.')
    if row.scene.parts.contact != "none":
        return linear
    if linear not in (None, "apart"):
        raise InputError(f'Argument `linear` is "{linear}", but the scene has no contact: its row is "apart".')
    return "apart"


def search_size(
    scan: int, starts: int, updates: int, linear: NaturalContact | None, direction: Direction
) -> SearchSize | None:
    """The size of the search; None: no search."""
    count_argument("starts", starts, 1)
    count_argument("scan", scan, starts)
    count_argument("updates", updates, 0)
    if not updates:
        return None
    if linear is None and direction != "independent":
        raise InputError(f'A search runs from rest, and cannot be "{direction}"; leave out `direction` or `updates`.')
    return SearchSize(scan, starts, updates)


def _patterns_of(
    row: MistunedRow, designs: Sequence[str], sigmas: Sequence[float], n_patterns: int, seed: int
) -> FloatArray:
    """The patterns of all lanes, see `_Drawn`."""
    count_argument("n_patterns", n_patterns, 1)
    seed_argument(seed)
    if not len(designs) or len(set(designs)) < len(designs):
        raise InputError(f"Argument `designs` must name patterns, each once, but is {list(designs)}.")
    if not len(sigmas) or not all(0 < sigma < 1 for sigma in sigmas) or np.any(np.diff(sigmas) <= 0):
        raise InputError(f"Argument `sigmas` must be shares from 0 to 1 that increase, but is {list(sigmas)}.")
    layout = row.scene.layout
    none = np.zeros((1, layout.blades))
    about = mistuned_designs(designs, [0.0], none, layout).reshape(-1, layout.blades)
    drawn = mistuned_designs(designs, sigmas, random_patterns(n_patterns, layout.blades, seed), layout)
    return np.concatenate([none, about, drawn.reshape(-1, layout.blades)])


def _in_closed_form(
    row: MistunedRow,
    patterns: FloatArray,
    linear: NaturalContact,
    size: SearchSize | None,
    resolved: ResolvedOptions,
    progress: Progress | None,
) -> tuple[RowResponses, _Run]:
    """The responses of linear rows, and how a search runs them; a solution counts as a lane of all periods."""
    periods = resolved.n_periods + resolved.transient
    done = [0]

    def tick(solutions: int) -> None:
        done[0] += periods * solutions
        if progress is not None:
            progress(min(done[0], in_all), in_all)

    problem = linear_problem(row, linear, tick)
    searched = 0.0 if size is None else problem.cost * size.most_patterns(problem.relative_cost)
    in_all = periods * (len(patterns) * problem.cost + round(searched))
    return problem.respond(patterns), _Run(problem, {"method": f"closed form, {linear}", "steps_per_period": 0})


def _marched(
    row: MistunedRow,
    patterns: FloatArray,
    direction: Direction,
    size: SearchSize | None,
    stored: tuple[str | os.PathLike[str] | None, bool],
    resolved: ResolvedOptions,
    progress: Progress | None,
) -> tuple[RowResponses, _Run]:
    """The responses of rows with contact, and how a search runs them."""
    scenes = grid_of_scenes(with_patterns(row.scene, patterns), {row.along: row.values})
    march = plan_march(resolved, flatten_lanes(scenes, 2), FOR_P_D)
    run = {"n_periods": resolved.n_periods, "transient": resolved.transient, "method": march.again}
    periods = resolved.n_periods + resolved.transient
    main = periods * len(patterns) * len(row.values) * (len(SINGLE_DIRECTIONS) if direction == "both" else 1)
    problem = partial(marched_problem, row, run, progress, main)
    search = 0.0 if size is None else problem(main).cost * size.most_patterns(problem(main).relative_cost)
    in_all = main + round(search)
    tick = None if progress is None else lambda done, _: progress(done, in_all)
    store, resume = stored
    responses, chatter = tuned_and_mistuned_responses(
        row, patterns, direction, run, store=None if store is None else Path(store), resume=resume, progress=tick
    )
    return responses, _Run(problem(in_all), {**march.attributes, "chatter": chatter})


def _monte_carlo(row: MistunedRow, drawn: _Drawn) -> dict[str, Any]:
    """The values of the result that are not of a search."""
    responses = drawn.responses
    designs = len(drawn.designs)
    top = largest_amplitudes(responses, row.values)
    if top.amplitude[0] == 0:
        raise InputError(f"{row.of} of the tuned row is 0, and nothing amplifies it; take another amplitude.")
    level = top.amplitude / top.amplitude[0]
    amplification = np.where(top.whole, level, np.nan)

    def random(a):
        return np.asarray(a)[1 + designs :].reshape(designs, len(drawn.sigmas), -1, *np.shape(a)[1:])

    def of_designs(a):
        return np.asarray(a)[1 : 1 + designs]

    amplitude = responses.amplitude.max(axis=-1)
    samples = random(amplification)
    quantiles = np.array(
        [[[quantile_interval(s[np.isfinite(s)], share) for share in QUANTILE_SHARES] for s in rows] for rows in samples]
    )
    return {
        "mistuning": random(drawn.patterns),
        "amplitude": random(amplitude),
        "status": random(responses.status),
        "amplification": samples,
        "worst_value": random(top.value),
        "worst_blade": random(top.blade),
        "participation_ratio": random(top.participation_ratio),
        "quantile": quantiles[..., 0],
        "quantile_low": quantiles[..., 1],
        "quantile_high": quantiles[..., 2],
        "design_mistuning": of_designs(drawn.patterns),
        "design_amplitude": of_designs(amplitude),
        "design_amplification": of_designs(amplification),
        "tuned_amplitude": amplitude[0],
        "tuned_status": responses.status[0],
        "tuned_largest": top.amplitude[0],
        "tuned_value": top.value[0],
        "left_out": int(np.sum(~top.whole[1 + designs :])),
        "at_end": int(np.sum(top.at_end)),
        "coarse": int(np.sum(top.coarse)),
        "narrow": random(top.coarse),
        "design_narrow": of_designs(top.coarse),
        "tuned_narrow": int(top.coarse[0]),
        "unsettled": int(np.sum(~responses.settled.astype(bool))),
        "unjudged": int(np.count_nonzero(responses.to_keep)) if responses.to_keep is not None else 0,
        "periods_to_keep": float(np.max(responses.to_keep)) if responses.to_keep is not None else 0.0,
    }


def _search_values(
    row: MistunedRow, problem: PatternProblem, size: SearchSize, sigma: float, seed: int, tuned: float
) -> dict[str, Any]:
    """The values of the result that are of the search for the worst pattern; `tuned` is the tuned row's amplitude."""
    found = search_worst_pattern(problem, row.scene.layout.blades, sigma, size, seed)
    return {
        "searched_mistuning": found.mistuning,
        "searched_amplitude": found.responses.amplitude[0].max(axis=-1),
        "search_cost": found.cost,
        "search_amplification": found.by_gradient / tuned,
        "random_amplification": found.by_chance / tuned,
        "search_ties": found.ties,
    }
