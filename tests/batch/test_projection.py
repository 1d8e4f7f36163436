"""What a long run will take: proportional to its periods and lanes."""

from dataclasses import replace

import numpy as np
import pytest

import jaxshroud as js
from jaxshroud.batch import runs
from jaxshroud.batch.periods import lanes_per_call
from jaxshroud.batch.runs import Plan
from jaxshroud.march.method import FAST


def test_a_projection_is_as_long_as_the_run():
    # The same lanes and ten times the periods: ten times as long, whatever the machine.
    plan = Plan(2, 8, 100, 0.0, FAST)
    lanes = js.scenes_from(
        {"contact.gamma": np.linspace(1.0, 2.0, 64)}, js.load("table1", ['parts.motion=["x"]']).scene
    )
    times = iter(range(8))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(runs, "process_time", lambda: float(next(times)))
        one, ten = (runs.projected_seconds(lanes, replace(plan, kept=kept)) for kept in (8, 98))
    assert ten == pytest.approx(10 * one)
    assert one == pytest.approx(10 / (2 * runs.PROJECTED_PERIODS))  # a second for the periods that are timed


def test_a_projection_of_rows_times_a_share_of_their_chunks():
    # A second for each run that is timed: with 200 chunks of 16 periods, a tenth is 320 periods of chunks, ten of 32.
    scene = js.load("row_chain5").scene
    width = lanes_per_call(scene.row_size)
    lanes = js.scenes_from({"contact.gamma": np.linspace(1.0, 2.0, 200 * width - 30)}, scene)
    plan, ran, times = Plan(2, 14, 100, 0.0, FAST), [], iter(range(4))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(runs, "process_time", lambda: float(next(times)))
        patch.setattr(runs, "run_lanes", lambda some, _, brief, __: ran.append((len(some.drive.omega), brief.kept)))
        projected = runs.projected_seconds(lanes, plan)
    assert ran[0] == (2, 1)  # compiles the program
    assert ran[1] in {(10 * width, 32), (10 * width - 30, 32)}
    assert projected == pytest.approx(200 * 16 / 320)
