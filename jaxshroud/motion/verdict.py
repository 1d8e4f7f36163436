"""What kind of motion a scene settles on, and why."""

from collections.abc import Sequence
from typing import Literal, NamedTuple

import jax
import numpy as np

from jaxshroud.batch.runs import Plan, run_lanes
from jaxshroud.batch.states import final_states
from jaxshroud.model.modes import Status
from jaxshroud.model.state import State
from jaxshroud.motion.copies import settled_copies
from jaxshroud.motion.evidence import Evidence, Stretches, Tick, gathered
from jaxshroud.motion.largest import TURNING
from jaxshroud.motion.shooting import Aim
from jaxshroud.motion.together import stacked
from jaxshroud.scene.scene import Scene

Kind = Literal["periodic", "quasi-periodic", "chaotic", "transient not over", "undecided", "stopped"]
ROUNDS = 3  # each twice as long as the one before, where that could not decide
CHAOS, REGULAR = 0.5, 0.2  # K above which the 0-1 test speaks for chaos, and below which for regular motion
STAYS = 1e-2  # of a displacement's size that the run may be off its orbit in the end
FLAT, SURE = 1e-4, 0.05  # exponents per period that count as 0 on a torus, and half widths that can tell


class Verdict(NamedTuple):
    """Of one lane."""

    kind: Kind
    q: int  # period number; 0 but for a periodic motion
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
    aim: Aim,
    stretches: Stretches = Stretches(),  # noqa: B008  a tuple
    rounds: int = ROUNDS,
    tick: Tick = lambda _: None,
) -> list[Verdict]:
    """The kind of motion of each lane (leading axis).

    Args:
        scenes: The scenes.
        states: Where they start, at drive phase 0.
        transient: Periods run first.
        aim: How the run is marched and orbits are closed.
        stretches: Of the first round.
        rounds: How often to look; each time goes on from where the last one ended, with stretches twice as long, for
            lanes on which the evidence does not agree.
        tick: Told of lane-periods done.
    """
    status = np.full(len(scenes.drive.omega), Status.OK, np.int32)
    if transient:
        runs = run_lanes(scenes, states, Plan(transient - 1, 1, aim.steps, 0.0, aim.method), tick)
        states, status = final_states(runs.last.state), np.asarray(runs.last.status)
    found: dict[int, Verdict] = {}
    open_lanes, first = np.arange(len(scenes.drive.omega)), transient
    for turn in range(rounds):
        now, last = stretches.longer(2**turn), turn == rounds - 1
        at = open_lanes
        some = jax.tree.map(lambda a, at=at: np.asarray(a)[at], scenes)
        evidence = gathered(some, states, status[at], first, now, aim, tick)
        first += now.all
        judged = [Verdict(*judgement(e, last), e, first) for e in evidence]
        found |= dict(zip(open_lanes.tolist(), judged, strict=True))
        going_on = [i for i, v in enumerate(judged) if v.kind in ("transient not over", "undecided")]
        if not going_on:
            break
        open_lanes = open_lanes[going_on]
        states = stacked([evidence[i].last for i in going_on])
    chaotic = [i for i in sorted(found) if found[i].kind == "chaotic"]
    return [verdict for _, verdict in sorted((found | _with_copies(scenes, found, chaotic, aim)).items())]


def _with_copies(scenes: Scene, found: dict[int, Verdict], lanes: list[int], aim: Aim) -> dict[int, Verdict]:
    """Verdicts on lanes that look chaotic, once copies of their runs have gone on for as long as its last stretch."""
    if not lanes:
        return {}
    some = jax.tree.map(lambda a: np.asarray(a)[lanes], scenes)
    states, periods = stacked([found[i].evidence.last for i in lanes]), found[lanes[0]].evidence.stretches.series
    known = settled_copies(some, states, periods, aim)
    seen = [(found[i].evidence._replace(settled=one), found[i].periods) for i, one in zip(lanes, known, strict=True)]
    return {i: Verdict(*judgement(e), e, n) for i, (e, n) in zip(lanes, seen, strict=True)}


def judgement(e: Evidence, last: bool = True) -> tuple[Kind, int]:
    """The kind and the period number that the evidence agrees on.

    Chaos and tori are seen in the last round only: of what looks chaotic for some hundred periods, one in ten settles
    on an orbit later, and a torus looks like a slow decay. Where a copy of the run settles on an orbit, its own chaos
    may end as well, or go on beside the orbit.
    """
    if e.status != Status.OK:
        return "stopped", 0
    grows, shrinks = e.exponent - e.ci > 0, e.exponent + e.ci < 0
    if e.cycle is not None and e.cycle.sound and not grows:
        return ("periodic", e.cycle.q) if e.away <= STAYS else ("transient not over", 0)
    if e.q and e.away <= STAYS and shrinks:
        return "periodic", e.q
    if last and grows and e.K > CHAOS:
        if e.settled is None or not e.settled.q:
            return "chaotic", 0
        return ("transient not over" if e.settled.copies == e.settled.of else "undecided"), 0
    if not e.q and last and not e.drifts and abs(e.exponent) <= max(e.ci, FLAT) <= SURE and e.K < REGULAR:
        return "quasi-periodic", 0
    return ("transient not over" if shrinks or e.drifts else "undecided"), 0


def sentence(verdict: Verdict) -> str:
    """The verdict with its evidence."""
    e = verdict.evidence
    if verdict.kind == "stopped":
        return f"stopped with {Status(e.status).name} within {verdict.periods} periods"
    spans = _spans(e)
    growth = f"largest exponent {e.exponent:.3g} ± {e.ci:.2g} a period (periods {spans[1]})"
    K = f"0–1 test K = {e.K:.2f} (periods {spans[2]})"
    return f"{verdict.words}: {_of_returns(e)} (periods {spans[0]}); {growth}; {K}{_of_copies(e)}"


def _spans(e: Evidence) -> Sequence[str]:
    """First and last period of each stretch."""
    n = e.stretches
    begins = np.cumsum([e.first, n.returns, TURNING + n.growth])
    firsts = begins + 1 + np.array([0, TURNING, 0])
    ends = begins + np.array([n.returns, TURNING + n.growth, n.series])
    return [f"{a}–{b}" for a, b in zip(firsts, ends, strict=True)]


def _of_copies(e: Evidence) -> str:
    """What copies of the run do, where they were asked."""
    if e.settled is None:
        return ""
    copies, of, q = e.settled
    return f"; {copies} of {of} copies settle on period {q}" if q else f"; none of {of} copies settles on an orbit"


def _of_returns(e: Evidence) -> str:
    """What the return map says, and the orbit that it led to."""
    cycle = e.cycle
    back = (
        f"samples return after {e.q} to {e.error:.1g} of their size"
        if e.q
        else (f"samples do not return, at best to {e.error:.1g} of their size")
    )
    if cycle is None or not cycle.found:
        return back
    lead = abs(cycle.others[0])
    kind = "stable" if cycle.sound else "not to be relied upon"
    slider = ", one for each place of the slider" if cycle.slider_is_free else ""
    return f"{back}, and an orbit closes to {cycle.residual:.0e}, {kind}{slider}, largest multiplier {lead:.3g}"
