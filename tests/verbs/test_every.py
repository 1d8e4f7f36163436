"""What `simulate` tells of a run does not depend on which of its steps are kept."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal, assert_equal

import jaxshroud as js
from jaxshroud.batch.sampling import MAX_UNKEPT, SampleGrid
from jaxshroud.batch.stretches import RunningAmplitudes
from jaxshroud.scene.keys import Motion

STEPS, PERIODS = 100, 4
RK4 = js.RungeKutta("rk4", steps=STEPS)
WAYS = {  # a march of each kind that has samples
    "steps": ([], dict(method=RK4)),
    "series": ([], dict(method=js.Taylor(order=8, tolerance=1e-9, steps=STEPS))),
    "events": ([], dict(method=RK4, events=True)),
    "free": (['parts.contact="none"'], dict(method=RK4)),
    "row": (["row.blades=3", "row.closed=true", "drive.engine_order=1"], dict(method=RK4)),
}
TOLD = [f"{name}_{of}" for name in ("x", "y", "theta") for of in ("mean", "rms", "peak", "free")]


@pytest.mark.parametrize(
    "way", [pytest.param(w, marks=pytest.mark.full) if w in ("series", "row") else w for w in WAYS]
)
def test_amplitudes_and_counts_do_not_depend_on_what_is_kept(way):
    # The same steps are marched, and each of the second half counts: only the order of sums differs, to rounding. 7 and
    # 150 divide neither the period nor the run, of whose steps some follow the last sample.
    settings, how = WAYS[way]
    scene = js.load("table1", ['parts.motion=["x"]', *settings]).scene
    whole, *others = (js.simulate(scene, n_periods=PERIODS, every=n, **how) for n in (1, 7, 150, PERIODS * STEPS))
    q, half = np.asarray(whole.motion.x), PERIODS * STEPS // 2
    seen = q[-half:] - q[-half:].mean(axis=0)
    # Of the samples of half the run themselves, without what lies in between: cubics move both by less than 1e-3.
    assert_allclose(whole.x_rms, np.sqrt((seen**2).mean(axis=0)), rtol=1e-3)
    assert_allclose(whole.x_peak, np.abs(seen).max(axis=0), rtol=1e-3)
    for run in others:
        for name in TOLD:
            assert_allclose(getattr(run, name), getattr(whole, name), rtol=1e-12, atol=0, err_msg=name)
        assert_array_equal(run.motion.x, q[:: run.every])
        assert run.status == whole.status
        assert run.turns == pytest.approx(len(run.t[1:]) * run.every / STEPS % 1)
        assert_equal(run.counters, whole.counters)
        assert_array_equal(run.energy_residual, whole.energy_residual)
        if how.get("events"):
            assert_array_equal(run.events.motion.x, whole.events.motion.x)
    assert abs(q[half::150, 0].std() / whole.x_rms[0] - 1) > 0.1  # a control: of the samples kept alone


@pytest.mark.parametrize("lanes", [1, 64, 10_000])
@pytest.mark.parametrize("every", [1, 7, 400])
def test_stretches_cover_the_run_and_hold_little_that_is_not_kept(lanes, every):
    # Each step is marched once, those that count one by one, and no stretch holds more than memory wants, or a period.
    grid = SampleGrid(0.0, 400, every, 4_000_000, counted=2_000_000)
    stretches = grid.stretches(lanes)
    assert [s.first for s in stretches] == [0, *np.cumsum([s.length for s in stretches])[:-1]]
    assert sum(s.length for s in stretches) == grid.length
    assert sum(len(s.kept(grid)) for s in stretches) == grid.samples
    assert all(s.apart == 1 for s in stretches if s.first >= 2_000_000)
    held = [s.samples - len(s.kept(grid)) for s in stretches]
    assert max(held) <= max(MAX_UNKEPT // lanes, 400)


@pytest.mark.parametrize("size", [1.0, 1e-10])
def test_small_vibrations_about_a_large_mean_keep_their_digits(size):
    # A whole period of a sine about 1: cubics through 1,000 samples err by 1e-11 of it, and rounding of the samples by
    # 1e-16 of the mean, which a difference of mean squares turns into 1e-8.
    t = 2 * np.pi * np.arange(1001) / 1000
    q, rate = ((1 + size * np.sin(t))[None, :, None], (size * np.cos(t))[None, :, None])
    motion = Motion(*[q] * 3, *[rate] * 3)
    of = lambda begin, end: Motion(*(a[:, begin:end] for a in motion))
    running = RunningAmplitudes(Motion(*(a[:, 0] for a in motion)), np.array([2 * np.pi / 1000]))
    for begin in range(1, 1001, 300):
        running.add(of(begin, min(begin + 300, 1001)))
    found = running.amplitudes
    assert_allclose(found.mean, 1, rtol=1e-12)
    assert_allclose(found.rms, size / np.sqrt(2), rtol=1e-5)
    assert_allclose(found.peak, size, rtol=1e-5)
    plain = np.sqrt(max(np.mean(q[:, 1:] ** 2) - np.mean(q[:, 1:]) ** 2, 0))
    assert (abs(plain * np.sqrt(2) / size - 1) > 0.1) == (size < 1)  # a control


def test_a_motion_that_overflows_has_no_amplitude_and_raises_nothing():
    huge = np.array([0.0, 1e200, -1e300])[None, :, None]
    running = RunningAmplitudes(Motion(*[huge[:, 0]] * 6), np.array([1.0]))
    running.add(Motion(*[huge[:, 1:]] * 6))
    assert not np.isfinite(running.amplitudes.rms).any()
