"""Progress where nobody looks at a terminal."""

import threading
from functools import partial
from typing import NamedTuple

import numpy as np

from jaxshroud.cache.programs import kept
from jaxshroud.cli import terminal
from jaxshroud.cli.terminal import LINE_INTERVAL, ProgressLines
from jaxshroud.orbits.batched_algorithms import StagedProgress, run_together


class Clock:
    """A clock that only waiting moves, once something was reported; it ends after half a minute."""

    def __init__(self):
        self.now, self.reported = 100.0, threading.Event()

    def __call__(self):
        return self.now

    def wait(self, seconds):
        self.reported.wait()
        self.now += seconds
        return self.now > 130


def test_a_line_is_written_every_ten_seconds(capsys, monkeypatch):
    clock = Clock()
    monkeypatch.setattr(terminal, "ProgressLines", partial(ProgressLines, clock=clock, pause=clock.wait))
    with terminal.progress_bar("lane-periods") as report:
        report(10, 200)
        clock.now += 10.0  # nothing but a compilation came before the first report
        report(50, 200)
        clock.reported.set()
    told = capsys.readouterr().err.splitlines()
    assert LINE_INTERVAL == 10.0
    assert len(told) == 2
    assert told[1] == "lane-periods: 50 of 200 in 0:00:30, 1.33/s, 0:01:52 left"


def test_compiling_is_said_while_something_compiles():
    clock = Clock()
    lines = ProgressLines("periods", clock=clock)
    clock.now += 12
    assert str(lines) == "periods: none in 0:00:12"
    told = []

    @kept()
    def traced(x):  # while it is traced, it is being compiled
        told.append(str(lines))
        return x

    traced(np.ones(3))
    assert told == ["periods: none in 0:00:12 (compiling)"]
    traced(np.ones(3))
    assert str(lines) == "periods: none in 0:00:12"
    lines(50, 200)
    assert "compiling" not in str(lines)


def test_the_end_is_told_once_a_tenth_is_done_and_of_each_part_anew():
    clock = Clock()
    lines = ProgressLines("periods", clock=clock)
    clock.now += 60  # compiles
    lines(1, 100)
    clock.now += 4
    lines(5, 100)
    assert str(lines) == "periods: 5 of 100 in 0:01:04, 1/s"
    clock.now += 15
    lines(20, 100)
    assert str(lines) == "periods: 20 of 100 in 0:01:19, 1/s, 0:01:20 left"
    lines(2, 10)  # another part, of which nothing is known yet
    assert str(lines) == "periods: 2 of 10 in 0:01:19"
    clock.now += 10
    lines(4.5, 10)
    assert str(lines) == "periods: 4.5 of 10 in 0:01:29, 0.25/s, 0:00:22 left"


def test_an_end_that_is_not_known_is_not_told():
    # A branch goes on beyond its estimate, for instance: "0:00:00 left" for minutes would be untrue.
    clock, told = Clock(), []
    lines = ProgressLines("periods", clock=clock)
    stages = StagedProgress(lines)

    def taking(requests):
        for _ in range(requests):
            clock.now += 10
            yield Pause(periods=1)
            told.append(str(lines))

    run_together([taking(6)], stages.stage(), periods=4)
    assert told[2] == "periods: 2 of 4 in 0:00:30, 0.1/s, 0:00:20 left"
    assert told[5] == "periods: 5 in 0:01:00, 0.1/s"  # beyond the estimate
    run_together([taking(2)], stages.stage(), periods=2)
    assert str(lines) == "periods: 6 of 6 in 0:01:20, 0.1/s"  # what comes next is not known


class Pause(NamedTuple):
    """A request of nothing."""

    periods: int
    alike: int = 0

    @staticmethod
    def answers(requests):
        return requests


def test_a_short_command_writes_none(capsys):
    with terminal.progress_bar("periods") as report:
        report(1, 1)
    assert capsys.readouterr().err == ""
