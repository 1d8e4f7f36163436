"""What a long run will take: proportional to its periods and lanes."""

from dataclasses import replace

import numpy as np
import pytest

import jaxshroud as js
from jaxshroud.batch.periods import lanes_per_call
from jaxshroud.batch.plan import Plan
from jaxshroud.cli import projection
from jaxshroud.march.method import FAST


def test_a_projection_is_as_long_as_the_run():
    # The same lanes and ten times the periods: ten times as long, whatever the machine.
    plan = Plan(2, 8, 100, 0.0, FAST)
    lanes = js.scenes_from(
        {"contact.gamma": np.linspace(1.0, 2.0, 64)}, js.load("table1", ['parts.motion=["x"]']).scene
    )
    times = iter(range(8))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(projection, "process_time", lambda: float(next(times)))
        patch.setattr(projection, "TRIAL_SECONDS", np.inf)
        patch.setattr(projection, "TRIAL_SHARE", np.inf)
        one, ten = (projection.projected_seconds(lanes, replace(plan, kept=kept)) for kept in (8, 98))
    assert ten == pytest.approx(10 * one)
    assert one == pytest.approx(10 / (2 * projection.PROJECTED_PERIODS))  # a second for the periods that are timed


# Half a second compiles. A tenth of 20 chunks of 2 periods is 4 periods of a chunk; else the trial ends beyond 10 s.
@pytest.mark.parametrize(("periods", "seconds"), [(2, 0.5 + 4 * 3 * 0.5), (1000, 0.5 + 10.5)])
def test_a_trial_ends_after_a_share_of_the_run_or_some_seconds(periods, seconds):
    # Calls of half a second of the clock and of the processor, each of which makes a third of a period of a chunk.
    scene, clock = js.load("row_chain5").scene, [0.0]
    width = lanes_per_call(scene.layout)
    lanes = js.scenes_from({"contact.gamma": np.linspace(1.0, 2.0, 20 * width)}, scene)

    def run_lanes(some, states, plan, tick):
        while True:
            clock[0] += 0.5
            tick(width / 3)

    with pytest.MonkeyPatch.context() as patch:
        for name in ("process_time", "perf_counter"):
            patch.setattr(projection, name, lambda: clock[0])
        patch.setattr(projection, "run_lanes", run_lanes)
        projected = projection.projected_seconds(lanes, Plan(0, periods, 100, 0.0, FAST))
    assert projected == pytest.approx(20 * periods * 3 * 0.5)
    assert clock[0] == pytest.approx(seconds)


@pytest.mark.parametrize(
    ("seconds", "words"),
    [(0.42, "0.42 s"), (48.3, "48 s"), (120.0, "2 min"), (1248.0, "21 min"), (20000.0, "5.6 h"), (4e5, "4.6 days")],
)
def test_a_time_is_told_in_words(capsys, monkeypatch, seconds, words):
    # As one says it, to two digits: trials know no more.
    monkeypatch.setattr(projection, "cores", lambda: 2)
    projection.print_projection(20, 64, 2 * seconds, seconds)
    told = capsys.readouterr().err
    assert f"20 runs: about {words} on 2 free cores, " in told
    assert ":" not in told.partition("runs:")[2]
    projection.print_projection(20, 64, seconds, None)  # elsewhere
    assert f"20 runs: about {words} of processor time, " in capsys.readouterr().err
