"""Which verdict evidence leads to, and verdicts on a few scenes."""

from dataclasses import replace

import jax
import numpy as np
import pytest

from jaxshroud import Status, load
from jaxshroud.batch.lanes import initial_states
from jaxshroud.march.method import FAST
from jaxshroud.model.prepared import initial_state
from jaxshroud.orbits.batched_algorithms import run_alone
from jaxshroud.orbits.shooting import ShootingOptions, closed_orbit
from jaxshroud.orbits.verdict import Verdict, judgement, verdict_text, verdicts
from jaxshroud.orbits.verdict_evidence import Evidence, SettledCopies, Stretches, settled_copies
from jaxshroud.scene.grids import scenes_at

BASE = load("table1", ['parts.motion=["x"]', "blades.c_x=40", "drive.F_0=60"]).scene
QUIET = {"status": 0, "q": 0, "error": 0.3, "drifts": False, "cycle": None, "away": np.nan}
AIM = ShootingOptions(100, 1e-11, FAST)


def evidence(exponent, ci, K, **more):
    known = {**QUIET, "exponent": exponent, "ci": ci, "K": K, **more}
    return Evidence(first=64, stretches=Stretches(), last=initial_state(BASE.initial), **known)


@pytest.mark.parametrize(
    ("known", "kind"),
    [
        (evidence(0.3, 0.1, 0.95), "chaotic"),
        (evidence(0.3, 0.1, 0.95, settled=SettledCopies(0, 64, 0)), "chaotic"),
        (evidence(0.3, 0.1, 0.95, settled=SettledCopies(5, 64, 0)), "chaotic"),  # that seem to return, to no orbit
        (evidence(0.3, 0.1, 0.95, settled=SettledCopies(5, 64, 8)), "undecided"),
        (evidence(0.3, 0.1, 0.95, settled=SettledCopies(64, 64, 8)), "transient not over"),
        (evidence(0.3, 0.4, 0.95), "undecided"),  # an exponent that may be nought
        (evidence(0.3, 0.1, 0.1), "undecided"),  # a growth that the 0-1 test does not see
        (evidence(1e-4, 5e-4, 0.05), "quasi-periodic"),
        (evidence(1e-4, 5e-4, 0.05, drifts=True), "transient not over"),
        (evidence(-0.05, 0.01, 0.05), "transient not over"),
        (evidence(-0.05, 0.01, 0.05, q=3, error=1e-5, away=1e-4), "periodic"),
        (evidence(-0.05, 0.01, 0.05, q=3, error=1e-5, away=0.1), "transient not over"),  # it has moved on
        (evidence(np.nan, np.nan, np.nan, status=Status.NOT_FINITE), "stopped"),
    ],
)
def test_evidence_leads_to_a_verdict(known, kind):
    assert judgement(known)[0] == kind
    told = verdict_text(Verdict(*judgement(known), known, 416))
    assert ("NOT_FINITE" in told) if kind == "stopped" else ("65–128" in told)


@pytest.mark.full
def test_beside_a_neutral_orbit_nothing_is_a_transient():
    # One block at the end of its spring, without damping: each start is an orbit, or a torus, of its own.
    free = load("table1", ['parts.motion=["x"]', "shroud.gap=1", "blades.c_x=0"]).scene
    scene = jax.tree.map(np.asarray, scenes_at(free, ["blades.k_x"], np.array([[1.1e5]])))
    rest = closed_orbit(jax.tree.map(lambda a: a[0], scene), initial_state(free.initial), 1, AIM)
    neutral = run_alone(rest)
    assert neutral.sound
    assert abs(neutral.others[0]) > 1 - 1e-5  # the rest is what the march loses
    beside = evidence(-1e-9, 1e-10, 0.05, q=1, error=1e-4, cycle=neutral, away=0.1, drifts=True)
    assert judgement(beside)[0] == "undecided"
    assert judgement(beside._replace(away=1e-4))[0] == "periodic"
    assert judgement(beside._replace(q=0, drifts=False))[0] == "quasi-periodic"
    open_orbit = replace(neutral, flags=("not converged",))  # as in a bottleneck beside a fold
    returns = evidence(-0.05, 0.01, 0.05, q=1, error=1e-9, cycle=open_orbit, away=1e-4)
    assert judgement(returns)[0] != "periodic"


def test_a_torus_is_not_seen_before_the_last_round():
    known = evidence(1e-4, 5e-4, 0.05)
    assert judgement(known, last=False)[0] == "undecided"


@pytest.mark.full
def test_scenes_are_judged_each_on_its_own():
    # The first two settle; the third begins so far out that its squares overflow, which stops no other.
    rows = [[0.5, 1e-6], [2.5, 1e-6], [2.5, 1e200]]
    scenes = scenes_at(BASE, ["contact.gamma", "initial.x[0]"], np.array(rows))
    short = Stretches(returns=24, growth=16, series=56)
    found = verdicts(scenes, initial_states(scenes), 32, AIM, short, rounds=1)
    assert [one.words for one in found] == ["period 1", "period 1", "stopped"]
    for one in found[:2]:
        cycle = one.evidence.cycle
        assert cycle is not None
        # The tangent's growth is that of the orbit's largest multiplier, from another stretch of the run.
        assert abs(one.evidence.exponent - np.log(abs(cycle.others[0]))) <= one.evidence.ci + 1e-3
        assert one.evidence.K == 0
        assert one.periods == 32 + short.all


@pytest.mark.full
def test_copies_settle_where_there_is_an_orbit():
    scenes = scenes_at(BASE, ["contact.gamma"], np.array([[0.5], [2.5]]))
    for one in settled_copies(scenes, initial_states(scenes), 128, AIM):
        assert one == (32, 32, 1)


def test_slow_decay_is_told_from_arrival():
    # A damper a hundred times lighter leaves a third of the start after a hundred periods.
    light = scenes_at(BASE, ["blades.c_x", "shroud.gap", "initial.x[0]"], np.array([[0.02, 1.0, 1e-2]] * 2))
    (found, _) = verdicts(light, initial_states(light), 0, AIM, Stretches(24, 16, 56), rounds=1)
    assert found.words == "transient not over"
