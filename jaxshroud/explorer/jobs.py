"""The computations that a page asks for, each in a thread of its own that leaves the cores to what is wanted first.

What a tab wishes is data, which goes to its engine; the jobs fulfil it there. A thread computes what its tab wants
last: a new wish ends the work on an earlier one.
"""

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

from jaxshroud.explorer.diagram import Amount, Window, diagram, joined, joined_map, map_axes, map_piece
from jaxshroud.explorer.exploration import Continue, Exploration, method_on_page
from jaxshroud.explorer.saves import result_file
from jaxshroud.march.method import Method
from jaxshroud.results.base import Result
from jaxshroud.results.diagnosis import Diagnosis
from jaxshroud.results.sweep import SweepResult
from jaxshroud.results.trajectory import Trajectory
from jaxshroud.scene.layout import Direction
from jaxshroud.verbs.diagnose import diagnose
from jaxshroud.verbs.simulate import simulate

LONGEST_WAIT = 1.0  # of a diagram for a run [s]; compiling may take longer
REPORT_INTERVAL = 0.1  # [s]
Yield = Callable[[], bool]  # whether something is wanted first
Choose = Callable[[Continue], Method]
Job = Callable[[Continue], None]


class Outdated(Exception):  # noqa: N818  not an error
    """The result of this work is no longer wanted."""


class Worker:
    """One thread; of the jobs that it is given while it works, it does the last one."""

    def __init__(self, failed: Callable[[Exception], None]):
        """A worker at rest.

        Args:
            failed: Called in the thread with what a job raises.
        """
        self.failed = failed
        self.wakened = threading.Condition()
        self.waiting = None
        self.number, self.closed, self.busy = 0, False, False
        self.thread = threading.Thread(target=self._work, daemon=True)
        self.thread.start()

    def submit(self, job: Job) -> None:
        """Do this next, and end what is being done."""
        with self.wakened:
            self.number += 1
            self.waiting = job
            self.busy = True
            self.wakened.notify()

    def cancel(self) -> None:
        """End what is being done."""
        with self.wakened:
            self.number += 1
            self.waiting = None

    def close(self) -> None:
        """End the thread, once what it does has noticed."""
        with self.wakened:
            self.closed = True
            self.number += 1
            self.wakened.notify()

    def _work(self) -> None:
        while True:
            with self.wakened:
                self.busy = self.waiting is not None
                self.wakened.wait_for(lambda: self.closed or self.waiting is not None)
                if self.closed:
                    return
                job = self.waiting
                number = self.number
                self.waiting = None
            self._do(job, number)

    def _do(self, job: Job | None, number: int) -> None:
        def go_on() -> None:
            if self.number != number:
                raise Outdated

        try:
            if job is not None:
                job(go_on)
        except Outdated:
            pass
        except Exception as error:
            if self.number == number:
                self.failed(error)


class Methods:
    """The method of each structure and accuracy: chosen for the first scene that has it, and kept."""

    def __init__(self, chosen: Callable[[Exploration, str, Method], None] = lambda *choice: None):
        """No methods yet.

        Args:
            chosen: Called with the scene and the accuracy for which a method was chosen, and with the method.
        """
        self.found: dict[Any, Method] = {}
        self.lock = threading.Lock()
        self.chosen = chosen

    def method(self, exploration: Exploration, accuracy: str, go_on: Continue = lambda: None) -> Method:
        """The method of a scene, which is chosen if there is none yet, by trials before each of which it may end."""
        with self.lock:
            found = self.known(exploration, accuracy)
            if found is None:
                try:
                    wish: str | float = float(accuracy)
                except ValueError:
                    wish = accuracy
                found = method_on_page(exploration.file, wish, go_on)
                self.learn(exploration, accuracy, found)
                self.chosen(exploration, accuracy, found)
        return found

    def learn(self, exploration: Exploration, accuracy: str, method: Method) -> None:
        """Take a method that was chosen elsewhere."""
        self.found[_call(exploration, accuracy)] = method

    def known(self, exploration: Exploration, accuracy: str) -> Method | None:
        """The method of a scene if it is chosen already."""
        return self.found.get(_call(exploration, accuracy))

    def forget(self, exploration: Exploration, accuracy: str) -> None:
        """Choose anew where the method turned out to be unstable for later numbers."""
        self.found.pop(_call(exploration, accuracy), None)


def _call(exploration: Exploration, accuracy: str) -> tuple[Any, ...]:
    return exploration.origin, exploration.structure, accuracy


class YieldingProgress:
    """Reports progress now and then, lets others go first, and ends work that is not wanted any more."""

    def __init__(self, go_on: Continue, tell: Callable[[float], None], first: Yield = lambda: False):
        self.go_on = go_on
        self.tell = tell
        self.first = first
        self.reported_at = 0.0

    def give_way(self) -> None:
        """Wait for what is wanted first, for a while."""
        since = time.monotonic()
        while self.first() and time.monotonic() - since < LONGEST_WAIT:
            self.go_on()
            time.sleep(0.005)
        self.go_on()

    def __call__(self, done: float, total: int) -> None:
        """Report that `done` of `total` are done."""
        since = time.monotonic()
        self.give_way()
        if since - self.reported_at > REPORT_INTERVAL:
            self.reported_at = since
            self.tell(done / max(total, 1))


def diagram_job(
    exploration: Exploration,
    method: Choose,
    window: Window,
    direction: Direction,
    amount: Amount,
    progress: Callable[[Continue, int], YieldingProgress],
    show: Callable[[int, SweepResult, SweepResult], None],
) -> Job:
    """A diagram, coarse first; in other directions than from rest at one spacing, as a finer one is another run."""

    def job(go_on: Continue) -> None:
        march = method(go_on)
        levels = []
        go_on()
        for level in range(amount.levels if direction == "independent" else 1):
            values = window.new_values(level, amount.values)
            report = progress(go_on, level)
            report.give_way()
            levels.append(diagram(exploration.file, window, values, direction, amount, march, report))
            go_on()
            show(level, levels[-1], joined(levels))

    return job


def map_job(
    exploration: Exploration,
    method: Choose,
    across: Window,
    up: Window,
    amount: Amount,
    progress: Callable[[Continue, int], YieldingProgress],
    show: Callable[[int, SweepResult], None],
) -> Job:
    """A map, coarse first."""

    def job(go_on: Continue) -> None:
        march = method(go_on)
        whole = None
        for level in range(amount.map_levels):
            pieces = [
                map_piece(exploration.file, axes, amount, march, progress(go_on, level))
                for axes in map_axes(across, up, level)
            ]
            whole = pieces[0] if whole is None else joined_map(whole, pieces)
            go_on()
            show(level, whole)

    return job


def run_job(
    exploration: Exploration,
    method: Choose,
    periods: int,
    show: Callable[[Trajectory], None],
) -> Job:
    """The motion of one scene."""

    def job(go_on: Continue) -> None:
        go_on()
        progress = YieldingProgress(go_on, lambda share: None)
        run = simulate(exploration.file, n_periods=periods, method=method(go_on), progress=progress)
        go_on()
        show(run)

    return job


def verdict_job(
    exploration: Exploration,
    method: Choose,
    first: Yield,
    show: Callable[[Diagnosis], None],
) -> Job:
    """The verdict on the motion of one scene, once all else is done."""

    def job(go_on: Continue) -> None:
        while first():
            go_on()
            time.sleep(0.05)
        progress = YieldingProgress(go_on, lambda share: None, first)
        found = diagnose(exploration.file.scene, method=method(go_on), progress=progress)
        go_on()
        show(found)

    return job


Show = Callable[..., None]  # called with what was found
Tell = Callable[[int, float], None]  # called with the level and the share of it that is done
Busy = Callable[[str], bool]  # whether the worker of this name is at work


@dataclass(frozen=True)
class RunWish:
    """The motion of a scene."""

    exploration: Exploration
    method: tuple[Exploration, str]  # the scene and the accuracy that it is chosen for
    periods: int

    def job(self, methods: Methods, show: Show, tell: Tell, busy: Busy) -> Job:
        """The job."""
        return run_job(self.exploration, partial(methods.method, *self.method), self.periods, show)


@dataclass(frozen=True)
class DiagramWish:
    """A diagram."""

    method: tuple[Exploration, str]
    window: Window
    direction: Direction
    amount: Amount

    def job(self, methods: Methods, show: Show, tell: Tell, busy: Busy) -> Job:
        """The job."""
        march = partial(methods.method, *self.method)
        progress = _progress(tell, lambda: busy("run"))
        return diagram_job(self.method[0], march, self.window, self.direction, self.amount, progress, show)


@dataclass(frozen=True)
class MapWish:
    """A map over the keys of two windows."""

    method: tuple[Exploration, str]
    windows: tuple[Window, Window]
    amount: Amount

    def job(self, methods: Methods, show: Show, tell: Tell, busy: Busy) -> Job:
        """The job."""
        march = partial(methods.method, *self.method)
        progress = _progress(tell, lambda: busy("run"))
        return map_job(self.method[0], march, *self.windows, self.amount, progress, show)


@dataclass(frozen=True)
class VerdictWish:
    """The verdict on the motion of a scene."""

    exploration: Exploration
    method: tuple[Exploration, str]

    def job(self, methods: Methods, show: Show, tell: Tell, busy: Busy) -> Job:
        """The job."""

        def first():
            return busy("run") or busy("diagram")

        return verdict_job(self.exploration, partial(methods.method, *self.method), first, show)


@dataclass(frozen=True)
class SaveWish:
    """A result as a file."""

    name: str
    result: Result

    def job(self, methods: Methods, show: Show, tell: Tell, busy: Busy) -> Job:
        """The job."""
        return lambda go_on: show(result_file(self.name, self.result))


Wish = RunWish | DiagramWish | MapWish | VerdictWish | SaveWish


def _progress(tell: Tell, first: Yield) -> Callable[[Continue, int], YieldingProgress]:
    return lambda go_on, level: YieldingProgress(go_on, lambda share: tell(level, share), first)
