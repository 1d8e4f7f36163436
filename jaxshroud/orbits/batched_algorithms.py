"""Algorithms for one lane, run for many lanes at once with batched evaluations.

An algorithm is a generator: it yields a request, `Periods` or `Derivatives`, receives the answer, and returns its
result. It is thus written for one lane, while equal requests of many lanes are computed as one batch. The largest batch
goes first, so that the lanes of small batches wait for more requests.
"""

import math
from collections import defaultdict
from collections.abc import Generator, Hashable, Sequence
from typing import Any, NamedTuple

import jax
import numpy as np

from jaxshroud.batch.flows import as_differentiable
from jaxshroud.batch.plan import Plan, Progress, Runs
from jaxshroud.batch.runs import run_lanes
from jaxshroud.batch.tangents import TangentProblem, Tangents, batched_tangents
from jaxshroud.batch.threads import Interrupted
from jaxshroud.march.method import Choices
from jaxshroud.model.prepared import State
from jaxshroud.scene.checks import NumericalError
from jaxshroud.scene.scene import Scene
from jaxshroud.scene.typed import T

LANE_ERRORS = (NumericalError, np.linalg.LinAlgError)  # errors of one lane, which do not stop the others


class Periods(NamedTuple):
    """A request for periods of a scene from a state; the answer is its `Runs`, with a leading axis of one lane."""

    scene: Scene
    state: State
    plan: Plan

    @property
    def alike(self) -> Hashable:
        """The key of requests that can be computed as one batch."""
        return self.plan

    @property
    def periods(self) -> int:
        """The number of drive periods."""
        return self.plan.transient + self.plan.kept

    @staticmethod
    def answers(requests: "Sequence[Periods]") -> list[Runs]:
        """The answers to the requests."""
        scenes, states = stacked([(one.scene, one.state) for one in requests])
        runs = run_lanes(scenes, states, requests[0].plan, lambda _: None)
        return [jax.tree.map(lambda a, i=i: a[i : i + 1], runs) for i in range(len(requests))]


class Derivatives(NamedTuple):
    """A request for tangents over `n` periods from drive phase 0, or over `turns` periods; the answer is `Tangents`."""

    course: TangentProblem
    n: int
    steps: int
    method: Choices
    turns: float | None = None  # of any length, in the place of one period

    @property
    def alike(self) -> Hashable:
        """The key of requests that can be computed as one batch."""
        return self.n, self.steps, self.method, self.turns is None

    @property
    def periods(self) -> int:
        """The number of drive periods, with all tangents counted as one run."""
        return self.n

    @staticmethod
    def answers(requests: "Sequence[Derivatives]") -> list[Tangents]:
        """The answers to the requests."""
        _, n, steps, method, _ = requests[0]
        problems, lengths = [one.course for one in requests], [one.turns for one in requests if one.turns is not None]
        method = as_differentiable(method)
        return batched_tangents(problems, n=n, steps=steps, method=method, turns=lengths or None)


Request = Periods | Derivatives
Algorithm = Generator[Request, Any, T]


def stacked(trees: Sequence[T]) -> T:
    """Trees of arrays stacked along a leading axis."""
    return jax.tree.map(lambda *a: np.stack(a), *trees)


class StagedProgress:
    """The progress of work whose stages become known on the way: each adds to what is to be done."""

    def __init__(self, report: Progress | None):
        self.report = report
        self.total = 0

    def stage(self) -> Progress:
        """The progress of the next stage; those before it have ended."""
        before = self.total

        def report_stage(done: int | float, total: int) -> None:
            self.total = before + max(math.ceil(done), total)
            if self.report is not None:
                self.report(before + done, self.total if total else 0)

        return report_stage


def run_together(
    algorithms: Sequence[Algorithm[T]], progress: Progress | None = None, periods: int = 0
) -> list[T | Exception]:
    """Run all algorithms together; the result of each, or the error that ended it.

    Args:
        algorithms: One for each lane.
        progress: Called with (lane-periods done, lane-periods in all) at the beginning and after every batch; the
            latter is 0, not known, while a lane is beyond the estimate.
        periods: An estimate of the drive periods of one lane.

    Raises:
        Interrupted: On Ctrl-C; `done` has the results so far, and None for the other lanes.
    """
    results: dict[int, Any] = {}
    pending: dict[int, Request] = {}
    simulated = np.zeros(len(algorithms), int)

    def advance(lane: int, answer: Any) -> None:
        try:
            pending[lane] = algorithms[lane].send(answer)
        except StopIteration as end:
            results[lane] = end.value
        except LANE_ERRORS as error:
            results[lane] = error

    if progress is not None and algorithms:
        progress(0, periods * len(algorithms))
    for lane in range(len(algorithms)):
        advance(lane, None)
    while pending:
        groups = defaultdict(list)
        for lane, request in pending.items():
            groups[type(request), request.alike].append(lane)
        lanes = max(groups.values(), key=len)
        requests = [pending.pop(lane) for lane in lanes]
        try:
            answers = type(requests[0]).answers(requests)  # type: ignore[arg-type]  # all of one type
        except Interrupted:
            raise Interrupted([results.get(lane) for lane in range(len(algorithms))] if results else None) from None
        for lane, request, answer in zip(lanes, requests, answers, strict=True):
            simulated[lane] += request.periods
            advance(lane, answer)
        if progress is not None:
            simulated[list(results)] = periods
            is_beyond = bool(np.any(simulated > periods))
            progress(int(simulated.sum()), 0 if is_beyond else periods * len(simulated))
    return [results[lane] for lane in range(len(algorithms))]


def run_alone(algorithm: Algorithm[T], progress: Progress | None = None, periods: int = 0) -> T:
    """Run the algorithm of a single lane; raises the error that ended it."""
    (result,) = run_together([algorithm], progress, periods)
    if isinstance(result, Exception):
        raise result
    return result
