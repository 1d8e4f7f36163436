"""Progress where nobody looks at a terminal."""

import threading
import time
from typing import NamedTuple

import numpy as np

from jaxshroud.activity import counted
from jaxshroud.cache.programs import kept
from jaxshroud.cli import commands, progress
from jaxshroud.cli.progress import (
    FIRST_LINE,
    LINE_INTERVAL,
    CommandReport,
    ProgressReport,
    lines_written,
    progress_bar,
    reported,
)
from jaxshroud.orbits import starts
from jaxshroud.orbits.batched_algorithms import StagedProgress, run_together
from jaxshroud.orbits.starts import LaneEnds


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


def test_lines_are_written_before_ten_seconds_have_passed(capsys):
    clock = Clock()
    with lines_written(clock.wait):
        report = ProgressReport("lane-periods", clock=clock)
        with reported(report):
            report(10, 200)
            clock.now += 10.0  # nothing but a compilation came before the first report
            report(50, 200)
            clock.reported.set()
            while clock.now <= 130:
                time.sleep(0.001)
    told = capsys.readouterr().err.splitlines()
    assert FIRST_LINE < 5.0
    assert LINE_INTERVAL < 10.0
    assert len(told) == 3
    assert told[1] == "lane-periods: 50 of 200 in 0:00:22, 4/s, 0:00:26 left"


def test_a_command_is_at_work_from_its_start_on():
    # Also while it reads its scene, tries methods and writes: what it has no report for.
    clock = Clock()
    command = CommandReport("check", clock=clock)
    clock.now += 8
    assert str(command) == "check: at work for 0:00:08"
    with counted("speeds", 49) as count:
        count(12)
        assert str(command) == "check: at work for 0:00:08 (speeds: 12 of 49)"
    assert str(command) == "check: at work for 0:00:08"


def test_work_that_is_not_counted_is_told_beside_the_count():
    clock = Clock()
    lines = ProgressReport("periods", clock=clock)
    with counted("lane-periods", 40) as count:
        count(10)
        assert str(lines) == "periods: none in 0:00:00 (lane-periods: 10 of 40)"
        lines(5, 100)  # it reports itself
        assert str(lines) == "periods: 5 of 100 in 0:00:00"


def test_time_left_does_not_grow_while_nothing_is_reported():
    # The last report tells when the work ends by its rate; compilations are not of that rate, nor of work that ends.
    clock, compiling = Clock(), [0.0]
    lines = ProgressReport("periods", clock=clock, compiling=lambda: compiling[0])
    lines(1, 100)
    clock.now += 9
    lines(10, 100)
    assert str(lines).endswith("1/s, 0:01:30 left")
    clock.now, compiling[0] = clock.now + 60, 60.0
    assert str(lines).endswith("1/s, 0:01:30 left")
    clock.now += 30
    assert str(lines).endswith("1/s, 0:01:00 left")
    clock.now += 60
    assert str(lines).endswith("1/s")  # by then it was to have ended


def test_compiling_is_said_while_something_compiles():
    clock = Clock()
    lines = ProgressReport("periods", clock=clock)
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
    lines = ProgressReport("periods", clock=clock)
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
    lines = ProgressReport("periods", clock=clock)
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


def test_starts_that_settle_early_are_done(monkeypatch):
    # The end is told by what is left: what settled lanes need not run is not, or the time left would grow.
    settled, ticks = [[1, 0, 0, 0], [2, 0, 3], [1]], []

    def run_round(scene, states, plan, ticker):
        ticker(len(states) * (plan.transient + plan.kept))
        ended = np.array(settled.pop(0))
        return LaneEnds(np.arange(len(ended)), np.zeros(len(ended), int), ended, *[np.zeros(len(ended))] * 5)

    monkeypatch.setattr(starts, "_run_round", run_round)
    ends = starts.run_until_settled(None, np.arange(4), 4096, 100, None, ticks.append)
    assert ends.number.tolist() == [1, 2, 1, 3]
    assert sum(ticks) == 4 * 4096


def test_no_command_is_silent(capsys, monkeypatch):
    # A command says what it is at from its start on, whatever takes long: here the natural frequencies of a data sheet.
    monkeypatch.setattr(progress, "FIRST_LINE", 0.02)
    monkeypatch.setattr(commands, "lines_written", lines_written)
    assert commands.main(["check", "table1"]) == 0
    assert "check: at work for 0:00:0" in capsys.readouterr().err


def test_a_short_command_writes_none(capsys):
    with lines_written(), progress_bar("periods") as report:
        report(1, 1)
    assert capsys.readouterr().err == ""
