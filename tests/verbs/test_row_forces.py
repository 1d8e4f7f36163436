"""Forces, friction's work and impacts at the interfaces of rows: those of the pair, and of plain sums over samples."""

from typing import NamedTuple

import numpy as np
import pytest
from command_line import read_json, run, sets
from row_runs import CHAIN_OF_TWO, PAIR

import jaxshroud as js
from jaxshroud.io.variable import Variable
from jaxshroud.model.modes import Status
from jaxshroud.results.amplitudes import WithLoads

pytestmark = pytest.mark.full

IN_X = 'parts.motion=["x"]'
HOW = {"n_periods": 4, "transient": 2, "method": js.RungeKutta("rk4", steps=200)}
ALL_KEPT = {"ledger": True, "forces": True, "amplitudes": True}
LOADS = [name for name, one in vars(WithLoads).items() if isinstance(one, Variable)]


def chain_and_pair(designs, how, *more):
    """The same designs as chains of two and as pairs, swept."""
    scenes = js.load("row_ring12", [*CHAIN_OF_TWO, *more]).scene, js.load("table1", [*PAIR, *more]).scene
    return [js.sweep(js.scenes_from(designs, scene), **ALL_KEPT, **how) for scene in scenes]


def assert_loads_are_equal(chain, pair):
    assert np.all(chain.status == Status.OK)
    for name in LOADS:
        got, want = getattr(chain, name), getattr(pair, name)
        assert got.shape == (*want.shape, 1)
        # Rounding alone, of sums that are taken in another order; where they are means over short times it shows more.
        size = np.max(np.abs(want), where=np.isfinite(want), initial=0.0)
        np.testing.assert_allclose(got[..., 0], want, rtol=1e-9, atol=1e-9 * size, err_msg=name)


def test_the_loads_of_a_chain_of_two_are_those_of_the_pair():
    designs = {"shroud.gap": [22e-6, 2e-2, -2e-3], "friction.mu": [0.5, 0.5, 50.0]}
    chain, pair = chain_and_pair(designs, HOW, IN_X)
    assert_loads_are_equal(chain, pair)
    assert (chain.data["N_max"].dims, pair.data["N_max"].dims) == (("lane", "interface"), ("lane",))
    touching, apart, stuck = range(3)
    assert chain.impacts[touching] > 0
    for name in ("N_max", "F_max", "friction_work", "impacts"):
        assert getattr(chain, name)[apart] == 0
    assert min(chain.N_max[stuck], chain.F_max[stuck]) > 0
    for name in ("slip", "friction_work", "impacts"):
        assert getattr(chain, name)[stuck] == 0  # exactly: a slider that sticks does not move
    assert (chain.time_apart[apart], chain.time_stick[stuck]) == (1, 1)


@pytest.mark.parametrize("contact", ["spring", "smooth"])
def test_the_loads_of_turning_blocks_are_those_of_the_pair(contact):
    # Under small moments, and pressed together at the start, faces are flat at times.
    designs = {"shroud.gap": [-2e-4, 22e-6, 22e-6], "drive.M_0": [0.05, 0.01, 0.3]}
    more = [f"parts.contact={contact}", *(["contact.width=50 um"] if contact == "smooth" else [])]
    chain, pair = chain_and_pair(designs, HOW | {"n_periods": 2, "transient": 0}, *more)
    assert_loads_are_equal(chain, pair)
    np.testing.assert_allclose(chain.theta_peak, pair.theta_peak, rtol=1e-9)
    assert contact == "smooth" or np.all(chain.counters["flat"][:2] > 0)


RING = [
    IN_X,
    "row.blades=3",
    "drive.engine_order=1",
    "row.mistuning=[0, 0.03, -0.02]",
    'shroud.gap=["22 um", "20 mm", "-2 mm"]',  # the first touches at times, the second never, the third sticks
    "friction.mu=[0.5, 0.5, 50]",
]
FINE = {"n_periods": 3, "method": js.RungeKutta("rk4", steps=2000, locate="bisection")}


class Sums(NamedTuple):
    """The loads of each interface (3,), from the samples of a run of blades that move along x alone."""

    N_max: np.ndarray
    F_max: np.ndarray
    N_mean: np.ndarray
    friction_work: np.ndarray
    slip: np.ndarray
    archard: np.ndarray
    impacts: np.ndarray
    approach_max: np.ndarray
    approach_mean: np.ndarray
    impulse_max: np.ndarray
    impulse_mean: np.ndarray


def plain_sums(run, scene, periods):
    """The loads from x and v_x alone: the friction force by return mapping, integrals by trapezia."""
    alpha, k, k_d, mu = (np.asarray(a) for a in (scene.shroud.alpha, scene.k, scene.friction.k_d, scene.friction.mu))
    t, (d, speed) = run.t, (a - np.roll(a, -1, axis=1) for a in (run.motion.x, run.motion.v_x))
    v, u = np.sin(alpha) * (d - np.asarray(scene.shroud.gap)), np.cos(alpha) * d
    N, pressed = k * np.maximum(v, 0.0), v > 0
    onset, end = ~pressed[:-1] & pressed[1:], pressed[:-1] & ~pressed[1:]
    onset[0] = False  # what is pressed together at the start does not collide
    rise = np.diff(v, axis=0)
    part = np.where(onset, v[1:] / np.where(onset, rise, 1.0), 1.0)  # of the interval in contact
    F = np.zeros_like(N)
    for i in range(1, len(t)):
        stuck = np.where(onset[i - 1], 0.0, F[i - 1]) + k_d * part[i - 1] * (u[i] - u[i - 1])
        F[i] = np.where(pressed[i], np.clip(stuck, -mu * N[i], mu * N[i]), 0.0)
    slips = np.where(pressed[:-1] & pressed[1:], np.diff(u - F / k_d, axis=0), 0.0)
    middle = lambda a: (a[1:] + a[:-1]) / 2
    impulse = middle(N) * np.diff(t)[:, None]
    closing = np.where(onset, speed[1:] * (1 - part) + speed[:-1] * part, 0.0) * np.sin(alpha)
    ended = [np.diff(np.cumsum(impulse[:, j])[np.flatnonzero(end[:, j])], prepend=0.0) for j in range(3)]
    with np.errstate(invalid="ignore"):
        approach_mean = closing.sum(axis=0) / onset.sum(axis=0)
    return Sums(
        N.max(axis=0),
        np.abs(F).max(axis=0),
        middle(N).mean(axis=0),
        (middle(F) * slips).sum(axis=0) / periods,
        np.abs(slips).sum(axis=0) / periods,
        (middle(N) * np.abs(slips)).sum(axis=0) / periods,
        onset.sum(axis=0) / periods,
        closing.max(axis=0),
        approach_mean,
        np.array([one.max(initial=0.0) for one in ended]),
        np.array([one.mean() if one.size else np.nan for one in ended]),
    )


def test_the_loads_of_a_ring_are_those_of_plain_sums_over_its_samples():
    scene = js.load("row_ring12", RING).scene
    sampled = js.simulate(scene, every=1, **FINE)
    got = js.sweep(scene, {"contact.k": [float(scene.k[0])]}, transient=0, forces=True, **FINE)
    assert sampled.time_apart[1] == sampled.time_stick[2] == 1
    want = plain_sums(sampled, scene, FINE["n_periods"])
    # Samples miss the instants of events by up to a step: of second order where a force vanishes there, of first order
    # in the slip, which samples lose where contact begins and ends.
    far = {"slip": 1e-2, "friction_work": 5e-4, "archard": 5e-4}
    for name, a in want._asdict().items():
        near = far.get(name, 1e-4)
        np.testing.assert_allclose(getattr(got, name)[0], a, rtol=near, atol=1e-12, err_msg=name)
    for name in ("N_max", "F_max"):  # which samples never exceed
        assert np.all(getattr(got, name)[0] >= getattr(want, name) * (1 - 1e-12))
    # Control: the interfaces exchanged.
    assert np.max(np.abs(np.roll(want.N_max, 1) / np.maximum(got.N_max[0], 1.0) - 1)) > 0.1


def test_forces_of_rows_are_swept_at_the_command_line(tmp_path, capsys):
    march = "--tableau rk4 --steps-per-period 200 --periods 4 --transient 2"
    along = "--along contact.gamma --values 2,3,4 --forces --amplitudes --ledger"
    run(f"sweep row_ring12 {sets(IN_X, *CHAIN_OF_TWO)} {along} {march} --out {tmp_path}/out")
    assert "largest normal force [N]" in capsys.readouterr().out
    found = js.open(tmp_path / "out" / "sweep.nc")
    assert found.F_max.shape == (3, 1)
    summary = read_json(tmp_path / "out" / "summary.json")
    assert summary["largest friction force [N]"] == found.F_max.max()
    assert (tmp_path / "out" / "sweep.png").stat().st_size > 0
    run(f"convert {tmp_path}/out/sweep.nc --out {tmp_path}/lanes.csv")
    assert "N_max[0] [N]" in (tmp_path / "lanes.csv").read_text().partition("\n")[0]
