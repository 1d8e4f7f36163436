"""The kind of motion on which a scene settles, with the evidence."""

from collections.abc import Sequence
from typing import Literal, NamedTuple

import jax
import numpy as np

from jaxshroud.batch.lanes import final_states
from jaxshroud.batch.plan import Plan
from jaxshroud.batch.runs import run_lanes
from jaxshroud.model.modes import Status
from jaxshroud.model.prepared import State
from jaxshroud.orbits.batched_algorithms import stacked
from jaxshroud.orbits.lyapunov import ALIGNMENT_PERIODS
from jaxshroud.orbits.orbit import PeriodicOrbit
from jaxshroud.orbits.shooting import ShootingOptions
from jaxshroud.orbits.verdict_evidence import Evidence, Stretches, Tick, gather_evidence, settled_copies
from jaxshroud.scene.scene import Scene
from jaxshroud.signals.effects import with_interval

MotionKind = Literal["periodic", "quasi-periodic", "chaotic", "transient not over", "undecided", "stopped"]
VERDICT_ROUNDS = 3  # each twice as long as the previous one, where that was inconclusive
CHAOTIC_K, REGULAR_K = 0.5, 0.2  # K above which the 0-1 test speaks for chaos, and below which for regular motion
MAX_ORBIT_OFFSET = 1e-2  # of a displacement's size: largest distance of the run from its orbit at the end
# exponent per period that counts as 0, and largest half width of its interval
ZERO_EXPONENT, MAX_EXPONENT_CI = 1e-4, 0.05


class Verdict(NamedTuple):
    """The verdict on one lane."""

    kind: MotionKind
    q: int  # period number; 0 unless the motion is periodic
    evidence: Evidence
    periods: int  # run in all

    @property
    def words(self) -> str:
        """The verdict in a word or two."""
        return f"period {self.q}" if self.kind == "periodic" else self.kind


def verdicts(
    scenes: Scene,
    states: State,
    transient: int,
    aim: ShootingOptions,
    stretches: Stretches = Stretches(),  # noqa: B008  a tuple
    rounds: int = VERDICT_ROUNDS,
    tick: Tick = lambda _: None,
) -> list[Verdict]:
    """The kind of motion of each lane (leading axis).

    Args:
        scenes: The scenes.
        states: Their states at drive phase 0.
        transient: Periods run first.
        aim: How runs are marched and orbits are closed.
        stretches: The stretches of the first round.
        rounds: The number of rounds; each continues the previous one, with stretches twice as long, for lanes on which
            the evidence does not agree.
        tick: Called with the number of lane-periods done.
    """
    status = np.full(len(scenes.drive.omega), Status.OK, np.int32)
    if transient:
        runs = run_lanes(scenes, states, Plan(transient - 1, 1, aim.steps, 0.0, aim.method), tick)
        states = final_states(runs.last.state)
        status = np.asarray(runs.last.status)
    results: dict[int, Verdict] = {}
    open_lanes = np.arange(len(scenes.drive.omega))
    first = transient
    for round_number in range(rounds):
        lengths = stretches.longer(2**round_number)
        last = round_number == rounds - 1
        lanes = open_lanes
        chosen = jax.tree.map(lambda a, lanes=lanes: np.asarray(a)[lanes], scenes)
        evidence = gather_evidence(chosen, states, status[lanes], first, lengths, aim, tick)
        first += lengths.all
        new = [verdict_of(e, first, last) for e in evidence]
        results |= dict(zip(open_lanes.tolist(), new, strict=True))
        unclear = [i for i, v in enumerate(new) if v.kind in ("transient not over", "undecided")]
        if not unclear:
            break
        open_lanes = open_lanes[unclear]
        states = stacked([evidence[i].last for i in unclear])
    chaotic = [i for i in sorted(results) if results[i].kind == "chaotic"]
    return [verdict for _, verdict in sorted((results | _verdicts_with_copies(scenes, results, chaotic, aim)).items())]


def _verdicts_with_copies(
    scenes: Scene, results: dict[int, Verdict], lanes: list[int], aim: ShootingOptions
) -> dict[int, Verdict]:
    """The verdicts on apparently chaotic lanes, after perturbed copies of their runs as long as the last stretch."""
    if not lanes:
        return {}
    chosen = jax.tree.map(lambda a: np.asarray(a)[lanes], scenes)
    states = stacked([results[i].evidence.last for i in lanes])
    periods = results[lanes[0]].evidence.stretches.series
    copies = settled_copies(chosen, states, periods, aim)
    evidence = [
        (results[i].evidence._replace(settled=outcome), results[i].periods)
        for i, outcome in zip(lanes, copies, strict=True)
    ]
    return {i: verdict_of(e, n) for i, (e, n) in zip(lanes, evidence, strict=True)}


def verdict_of(e: Evidence, periods: int, last: bool = True) -> Verdict:
    """The verdict on a lane by its evidence, after so many periods; see `judgement`."""
    kind, q = judgement(e, last)
    return Verdict(kind, q, e, periods)


def judgement(e: Evidence, last: bool = True) -> tuple[MotionKind, int]:
    """The kind and the period number that the evidence agrees on.

    Chaos and tori are accepted in the last round only: of motions that seem chaotic for some hundred periods, one in
    ten settles on an orbit later, and a slow decay resembles a torus. Where a copy of the run settles on an orbit, the
    chaos of the run itself may end as well, or coexist with the orbit. Beside a neutral orbit nothing is a transient.
    Where Newton's method does not close an orbit, as in a bottleneck beside a fold, its return does not make it one.
    """
    if e.status != Status.OK:
        return "stopped", 0
    is_neutral = e.cycle is not None and e.cycle.sound and _is_neutral(e.cycle)
    grows, shrinks = e.exponent - e.ci > 0, e.exponent + e.ci < 0
    if e.cycle is not None and e.cycle.sound and not grows:
        if e.away <= MAX_ORBIT_OFFSET:
            return "periodic", e.cycle.q
        if not is_neutral:
            return "transient not over", 0
    is_doubtful = e.cycle is not None and "not converged" in e.cycle.flags
    if e.q and e.away <= MAX_ORBIT_OFFSET and shrinks and not is_doubtful:
        return "periodic", e.q
    if last and grows and e.K > CHAOTIC_K:
        if e.settled is None or not e.settled.q:
            return "chaotic", 0
        return ("transient not over" if e.settled.copies == e.settled.of else "undecided"), 0
    if (
        not e.q
        and last
        and not e.drifts
        and abs(e.exponent) <= max(e.ci, ZERO_EXPONENT) <= MAX_EXPONENT_CI
        and e.K < REGULAR_K
    ):
        return "quasi-periodic", 0
    return ("transient not over" if (shrinks or e.drifts) and not is_neutral else "undecided"), 0


def _is_neutral(orbit: PeriodicOrbit) -> bool:
    """Whether a stable orbit draws no motion to itself: its exponent counts as 0."""
    return bool(abs(orbit.others[0]) >= np.exp(-ZERO_EXPONENT * orbit.q))


def verdict_text(verdict: Verdict) -> str:
    """The verdict with its evidence as text."""
    e = verdict.evidence
    if verdict.kind == "stopped":
        return f"stopped with {Status(e.status).name} within {verdict.periods} periods"
    spans = _period_ranges(e)
    exponent = with_interval(e.exponent, e.ci).replace("+-", "±")
    growth = f"largest exponent {exponent} a period (periods {spans[1]})"
    K = f"0–1 test K = {e.K:.2f} (periods {spans[2]})"
    return f"{verdict.words}: {_returns_text(e)} (periods {spans[0]}); {growth}; {K}{_copies_text(e)}"


def _period_ranges(e: Evidence) -> Sequence[str]:
    """The first and the last period of each stretch."""
    n = e.stretches
    begins = np.cumsum([e.first, n.returns, ALIGNMENT_PERIODS + n.growth])
    firsts = begins + 1 + np.array([0, ALIGNMENT_PERIODS, 0])
    ends = begins + np.array([n.returns, ALIGNMENT_PERIODS + n.growth, n.series])
    return [f"{a}–{b}" for a, b in zip(firsts, ends, strict=True)]


def _copies_text(e: Evidence) -> str:
    """The outcome of the perturbed copies, if there are any."""
    if e.settled is None:
        return ""
    copies, of, q = e.settled
    return f"; {copies} of {of} copies settle on period {q}" if q else f"; none of {of} copies settles on an orbit"


def _returns_text(e: Evidence) -> str:
    """The result of the return map, and the orbit that it led to."""
    cycle = e.cycle
    returns = (
        f"samples return after {e.q} to {e.error:.1g} of their size"
        if e.q
        else (f"samples do not return, at best to {e.error:.1g} of their size")
    )
    if cycle is None or not cycle.found:
        return returns
    lead = abs(cycle.others[0])
    kind = "stable" if cycle.sound else "not to be relied upon"
    slider = ", one for each place of the slider" if cycle.slider_is_free else ""
    return f"{returns}, and an orbit closes to {cycle.residual:.0e}, {kind}{slider}, largest multiplier {lead:.3g}"
