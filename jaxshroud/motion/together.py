"""Algorithms of one lane, run for many lanes at once.

An algorithm is a generator. It yields what it wants computed, `Periods` or `Derivatives`, is sent the answer, and
returns what it found: so it reads as if there were one lane only, while what many lanes want alike is computed as one
batch. The largest batch goes first, so that the lanes of small ones wait for more.
"""

from collections import defaultdict
from collections.abc import Generator, Hashable, Sequence
from typing import Any, NamedTuple, TypeVar

import jax
import numpy as np

from jaxshroud.batch.runs import Plan, Progress, Runs, run_lanes
from jaxshroud.batch.tangents import Course, Tangents, all_tangents, differentiable
from jaxshroud.batch.threads import Interrupted
from jaxshroud.march.method import Choices
from jaxshroud.model.state import State
from jaxshroud.scene.errors import NumericalError
from jaxshroud.scene.scene import Scene

T = TypeVar("T")
FAILURES = (NumericalError, np.linalg.LinAlgError)  # of one lane, which do not stop the others


class Periods(NamedTuple):
    """Periods of a scene from a state; the answer is its `Runs`, with a leading axis of one lane."""

    scene: Scene
    state: State
    plan: Plan

    @property
    def alike(self) -> Hashable:
        """What is asked for with the same can be computed as one batch."""
        return self.plan

    @property
    def periods(self) -> int:
        """Drive periods that it takes."""
        return self.plan.transient + self.plan.kept

    @staticmethod
    def answers(wanted: "Sequence[Periods]") -> list[Runs]:
        """What came of each."""
        scenes, states = stacked([(one.scene, one.state) for one in wanted])
        runs = run_lanes(scenes, states, wanted[0].plan, lambda _: None)
        return [jax.tree.map(lambda a, i=i: a[i : i + 1], runs) for i in range(len(wanted))]


class Derivatives(NamedTuple):
    """Tangents over `n` periods from drive phase 0; the answer is `Tangents`."""

    course: Course
    n: int
    steps: int
    method: Choices

    @property
    def alike(self) -> Hashable:
        """What is asked for with the same can be computed as one batch."""
        return self.n, self.steps, self.method

    @property
    def periods(self) -> int:
        """Drive periods that it takes, all tangents counted as one run."""
        return self.n

    @staticmethod
    def answers(wanted: "Sequence[Derivatives]") -> list[Tangents]:
        """What came of each."""
        _, n, steps, method = wanted[0]
        return all_tangents([one.course for one in wanted], n=n, steps=steps, method=differentiable(method))


Wanted = Periods | Derivatives
Algorithm = Generator[Wanted, Any, T]


def stacked(trees: Sequence[T]) -> T:
    """Trees of arrays as one with a leading axis."""
    return jax.tree.map(lambda *a: np.stack(a), *trees)


def together(
    algorithms: Sequence[Algorithm[T]], progress: Progress | None = None, most: int = 0
) -> list[T | Exception]:
    """What each algorithm returns, or the error that ended it.

    Args:
        algorithms: One for each lane.
        progress: Called with (lane-periods done, lane-periods at most) after every batch.
        most: Drive periods that one lane takes, about and at most.

    Raises:
        Interrupted: Ctrl-C; `done` has what had been found, and None for the other lanes.
    """
    found: dict[int, Any] = {}
    wanted: dict[int, Wanted] = {}
    spent = np.zeros(len(algorithms), int)

    def go_on(lane: int, answer: Any) -> None:
        try:
            wanted[lane] = algorithms[lane].send(answer)
        except StopIteration as end:
            found[lane] = end.value
        except FAILURES as error:
            found[lane] = error

    for lane in range(len(algorithms)):
        go_on(lane, None)
    while wanted:
        groups = defaultdict(list)
        for lane, one in wanted.items():
            groups[type(one), one.alike].append(lane)
        lanes = max(groups.values(), key=len)
        asked = [wanted.pop(lane) for lane in lanes]
        try:
            answers = type(asked[0]).answers(asked)  # type: ignore[arg-type]  # all are of its type
        except Interrupted:
            raise Interrupted([found.get(lane) for lane in range(len(algorithms))] if found else None) from None
        for lane, one, answer in zip(lanes, asked, answers, strict=True):
            spent[lane] += one.periods
            go_on(lane, answer)
        if progress is not None:
            spent[list(found)] = most
            progress(int(np.minimum(spent, most).sum()), most * len(spent))
    return [found[lane] for lane in range(len(algorithms))]


def alone_found(algorithm: Algorithm[T], progress: Progress | None = None, most: int = 0) -> T:
    """What the algorithm of a single lane returns; raises what ended it."""
    (found,) = together([algorithm], progress, most)
    if isinstance(found, Exception):
        raise found
    return found
