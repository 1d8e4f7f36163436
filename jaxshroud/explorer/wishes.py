"""What a tab may wish to have computed, as data that goes to its engine, and the jobs that fulfil it there."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from jaxshroud.explorer.diagram import Amount, Window
from jaxshroud.explorer.exploration import Exploration
from jaxshroud.explorer.jobs import Methods, Yield, YieldingProgress, diagram_job, map_job, run_job, verdict_job
from jaxshroud.explorer.saves import result_file
from jaxshroud.explorer.worker import Continue, Job
from jaxshroud.results.base import Result
from jaxshroud.scene.parts import Direction

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
        march, progress = partial(methods.method, *self.method), _progress(tell, lambda: busy("run"))
        return diagram_job(self.method[0], march, self.window, self.direction, self.amount, progress, show)


@dataclass(frozen=True)
class MapWish:
    """A map over the keys of two windows."""

    method: tuple[Exploration, str]
    windows: tuple[Window, Window]
    amount: Amount

    def job(self, methods: Methods, show: Show, tell: Tell, busy: Busy) -> Job:
        """The job."""
        march, progress = partial(methods.method, *self.method), _progress(tell, lambda: busy("run"))
        return map_job(self.method[0], march, *self.windows, self.amount, progress, show)


@dataclass(frozen=True)
class VerdictWish:
    """The verdict on the motion of a scene."""

    exploration: Exploration
    method: tuple[Exploration, str]

    def job(self, methods: Methods, show: Show, tell: Tell, busy: Busy) -> Job:
        """The job."""
        first = lambda: busy("run") or busy("diagram")
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
