"""Rings by their sector: a small ring in the place of a large one, in all that results tell, and what it cannot see."""

import tomllib
from argparse import Namespace

import equinox as eqx
import jax
import numpy as np
import pytest
import tomli_w
from command_line import refused, sets
from numpy.testing import assert_allclose, assert_array_equal

import jaxshroud as js
from jaxshroud.batch.lanes import initial_states
from jaxshroud.batch.plan import Plan
from jaxshroud.batch.runs import folded, run_lanes
from jaxshroud.batch.tangents import run_flow
from jaxshroud.cli.mistune import claimed_store
from jaxshroud.cli.terminal import CommandError
from jaxshroud.march.method import choices
from jaxshroud.scene.checks import InputError
from jaxshroud.scene.config import load, parse
from jaxshroud.scene.sector import sector_blades
from jaxshroud.scene.text import text_of
from jaxshroud.verbs.design_problem import problem_of
from jaxshroud.verbs.gradient_ascent import _perturbed_start, exact_slopes

METHOD = js.RungeKutta("dopri8", steps=60)
HEAVY = ["blades.I=0.00246"]  # light blocks chatter: equal blades of the whole ring soon differ there too
ALONG_X = [*HEAVY, 'parts.motion=["x"]']
SHORT = {"n_periods": 3, "method": METHOD}
STATES = ("x", "y", "theta", "v_x", "v_y", "u_s", "mode", "N", "F")
RESIDUALS = ("energy_residual", "period_residual")  # rounding errors themselves


def ring(*options):
    return load("row_ring12", [*ALONG_X, *options])


def harmonics(*options):
    """The ring under the harmonics 4 and 8 of engine order 1."""
    document = tomllib.loads(ring("drive.engine_order=1", "drive.omega=134", *options).text())
    drive = document["drive"]
    for name in ("beta", "F_0", "M_0"):
        del drive[name]
    drive["harmonic"] = [{"order": 4, "F": 60.0, "beta": 0.5}, {"order": 8, "F": 20.0, "beta": 0.2, "phase": 1.0}]
    return parse(tomli_w.dumps(document), "harmonics.toml")


def by_sector(scene_file):
    return parse(scene_file.text().replace("[row]", '[row]\nsector = "auto"'), "ring.toml")


def largest_difference(whole, small):
    """The largest difference of any variable, over its largest number; all have the same axes and gaps."""
    differences = {}
    for name, one in whole.data.variables.items():
        other = small.data.variables[name]
        assert (one.dims, one.shape, one.dtype) == (other.dims, other.shape, other.dtype), name
        if one.dtype.kind in "biuf" and name not in RESIDUALS:
            a, b = (np.asarray(numbers.values, float) for numbers in (one, other))
            assert_array_equal(np.isnan(a), np.isnan(b), err_msg=name)
            differences[name] = np.nanmax(np.abs(a - b), initial=0) / max(np.nanmax(np.abs(a), initial=0), 1e-300)
    assert {*whole.data.variables} == {*small.data.variables}
    return differences


def assert_alike(whole, small, most):
    differences = largest_difference(whole, small)
    assert not {name: d for name, d in differences.items() if d > most}


def assert_equal_runs(scene_file, states=1e-12, others=1e-9):
    # Rounding differs in sums over the row and grows from contact to contact; integrals and means lose more digits.
    differences = largest_difference(js.simulate(scene_file, **SHORT), js.simulate(by_sector(scene_file), **SHORT))
    worst = {name: d for name, d in differences.items() if d > (states if name in STATES else others)}
    assert not worst


@pytest.mark.full
@pytest.mark.parametrize(("order", "blades"), [(3, 4), (4, 3), (6, 2)])
def test_a_small_ring_moves_as_the_whole_one(order, blades):
    scene_file = ring(f"drive.engine_order={order}")
    assert sector_blades(scene_file.scene) == blades
    assert_equal_runs(scene_file)


def test_the_sector_is_of_all_harmonics():
    assert sector_blades(harmonics().scene) == 3


@pytest.mark.full
def test_a_sector_of_all_harmonics_moves_as_the_whole_ring():
    assert_equal_runs(harmonics())


@pytest.mark.full
@pytest.mark.parametrize(
    ("options", "states"),
    [
        (["drive.engine_order=4", "blades.B_x=0.5", "shroud.gap_at=30um", "shroud.gap_at_speed=200"], 1e-12),
        (["contact.points=2"], 1e-12),
        (["coupling.k_x=1e4", "coupling.c_x=1"], 1e-9),  # rounding grows in this one, in the whole ring as well
        (["parts.friction=none"], 1e-12),
        (["initial.start=static", "shroud.gap=-5um"], 1e-9),
    ],
)
def test_a_small_ring_moves_as_the_whole_one_in_all_coordinates(options, states):
    assert_equal_runs(load("row_ring12", [*HEAVY, *options]), states, others=np.inf)


def test_a_sweep_tells_the_same_of_every_blade():
    how = {"n_periods": 6, "transient": 6, "method": js.RungeKutta(steps=200), "forces": True, "amplitudes": True}
    omega = {"drive.omega": np.array([500.0, 536.0, 600.0])}
    whole, small = (js.sweep(one, omega, **how) for one in (ring(), by_sector(ring())))
    assert_alike(whole, small, 1e-9)
    assert whole.x_peak.shape == (3, 12)


@pytest.mark.full
def test_verbs_tell_the_same_of_every_blade():
    how = {"n_periods": 4, "transient": 4, "method": METHOD}
    whole, small = ring(), by_sector(ring())
    gaps = {"shroud.gap": np.array([2e-5, 3e-5])}
    for run in (
        lambda scene: js.power(scene, **how),
        lambda scene: js.sweep(scene, gaps, direction="forward", **how),
        lambda scene: js.table(scene, {"contact.gamma": [2.0, 3.0]}, **how),
        lambda scene: js.scatter(scene, {"friction.mu": 0.1}, draws=4, **how),
    ):
        assert_alike(run(whole), run(small), 1e-8)


@pytest.mark.full
def test_a_march_may_begin_where_another_has_ended():
    first = js.simulate(by_sector(ring()), **SHORT)
    again = [js.simulate(one, first.last, **SHORT) for one in (ring(), by_sector(ring()))]
    assert_allclose(again[1].motion.x, again[0].motion.x, rtol=0, atol=1e-12 * again[0].motion.x.max())


def one_lane(scene):
    return jax.tree.map(lambda a: np.asarray(a)[None], scene)


def test_what_does_not_repeat_is_marched_whole():
    lane = one_lane(by_sector(ring()).scene)
    states = initial_states(lane)
    small = folded(lane, states)
    assert (small.copies, small.scenes.layout.blades, small.scenes.row.sector) == (3, 4, "whole")
    moved = eqx.tree_at(lambda s: s.motion.x, states, states.motion.x + 1e-6 * (np.arange(12) == 5))
    mistuned = js.scenes_from({"row.mistuning[3]": [0.0, 0.01]}, by_sector(ring()))
    orders = js.scenes_from({"drive.engine_order": [3, 4]}, by_sector(ring()))
    for scenes, starts in ((lane, moved), (mistuned, initial_states(mistuned)), (orders, initial_states(orders))):
        whole = folded(scenes, starts)
        assert (whole.copies, whole.scenes.layout.blades, whole.scenes.row.sector) == (1, 12, "whole")


def test_the_speed_of_the_rotor_is_that_of_the_whole_ring():
    scene = load("row_ring12", ["shroud.gap_at=30um", "shroud.gap_at_speed=200"]).scene
    lane = one_lane(js.load("row_ring12", ["shroud.gap_at=30um", "shroud.gap_at_speed=200", "row.sector=auto"]).scene)
    small = folded(lane, initial_states(lane)).scenes
    assert_array_equal(small.running_shroud.gap[0], scene.running_shroud.gap[:4])


# Four blades in anti-phase, whose wave is unstable at this frequency: two opposite blades come to swing more.
BROKEN = ["row.blades=4", "drive.engine_order=2", "drive.omega=923"]


@pytest.mark.full
def test_a_small_ring_cannot_see_that_a_wave_breaks():
    how = {"n_periods": 4, "transient": 400, "method": METHOD, "amplitudes": True}
    gamma = {"contact.gamma": np.array([2.6])}
    small = js.sweep(by_sector(ring(*BROKEN)), gamma, **how).x_peak[0]
    whole = js.sweep(ring(*BROKEN, "initial.x=[1e-6,0,0,0]"), gamma, **how).x_peak[0]
    assert np.ptp(small) <= 1e-9 * small.max()
    assert max(np.ptp(whole[::2]), np.ptp(whole[1::2])) > 0.05 * whole.max()


@pytest.mark.full
def test_stability_is_told_by_the_whole_ring():
    scene = by_sector(ring(*BROKEN)).scene
    found = js.orbit(scene, q=1, state=js.simulate(scene, n_periods=400, every=60, method=METHOD).last, method=METHOD)
    other = js.orbit(ring(*BROKEN).scene, q=1, state=found.start, method=METHOD)
    assert len(found.multipliers) == 28  # six numbers of each of four blades, and a slider at each interface
    assert np.abs(found.multipliers).max() > 1.001
    assert_allclose(np.abs(found.multipliers).max(), np.abs(other.multipliers).max(), rtol=1e-6)


def test_a_scene_by_its_sector_is_written_and_read():
    scene = by_sector(ring()).scene
    assert scene.row.sector == "auto"
    assert parse(text_of(scene, {"periods": 1}), "again").scene.row.sector == "auto"
    assert "sector" not in ring().text() + ring("row.sector=whole").text() + text_of(ring().scene, {"periods": 1})


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["row.closed=false"], "closed rings"),
        (["row.mistuning={sigma=0.01,seed=1}"], "row.mistuning differs"),
        (["shroud.gap[3]=30um"], "shroud.gap differs"),
        (["initial.x[3]=1um"], "initial.x differs"),
        (["drive.engine_order=5"], "gains nothing"),
        (["drive.phase=[0,1,0,0,0,0,0,0,0,0,0,0]"], "engine order"),
        (["row.sector=all"], "sector"),
    ],
)
def test_what_is_no_sector_is_refused_in_one_line(options, message, capsys, tmp_path):
    changes = sets("row.sector=auto", *options)
    assert message in refused(capsys, f"simulate row_ring12 {changes} --periods 1 --out {tmp_path}/run.nc")


def test_own_rows_are_checked_too():
    with pytest.raises(InputError, match="closed rings"):
        js.Row(12, sector="auto")
    with pytest.raises(InputError, match="sector"):
        js.Row(12, True, sector="half")


def test_check_tells_what_is_not_seen():
    assert any("4 of the 12 blades" in line for line in js.check(by_sector(ring())).advice)
    assert not any("blade i + 4" in line for line in js.check(ring()).advice)


def runs_of(scene_file, plan):
    lane = one_lane(scene_file.scene)
    return run_lanes(lane, initial_states(lane), plan, lambda _: None)


@pytest.mark.parametrize("options", [[], ["contact.points=2"]])
@pytest.mark.full
def test_lanes_at_their_end_are_those_of_the_whole_ring(options):
    plan = Plan(1, 2, 60, 0.0, choices(METHOD)._replace(ledger=True, forces=True, amplitudes=True))
    whole, small = (runs_of(one, plan) for one in (ring(*options), by_sector(ring(*options))))
    assert jax.tree.structure(whole) == jax.tree.structure(small)
    for one, other in zip(jax.tree.leaves(whole), jax.tree.leaves(small), strict=True):
        assert np.shape(one) == np.shape(other)
    # What is summed over the row; rounding errors of the balance themselves are left out.
    for name in ("work", "gross", "viscous", "dropped"):
        assert_allclose(getattr(small.samples, name), getattr(whole.samples, name), rtol=1e-11, atol=1e-12)


SPEEDS = {"drive.omega": [530.0, 540.0]}
COARSE = js.RungeKutta("rk4", steps=100)
FOUR = ["row.blades=4", "drive.engine_order=2"]  # by a sector of two


@pytest.mark.full
def test_a_tuned_row_goes_by_its_sector_and_patterns_whole(tmp_path, monkeypatch):
    how = {"n_periods": 2, "transient": 2, "method": COARSE, "n_patterns": 2}
    whole = js.mistune(ring(*FOUR), SPEEDS, **how)
    one = by_sector(ring(*FOUR))
    lanes = []

    def told(scenes, states, *rest):
        lanes.append((scenes.layout.blades, folded(scenes, states).copies, len(scenes.drive.omega)))
        return run_lanes(scenes, states, *rest)

    monkeypatch.setattr("jaxshroud.batch.runs.run_lanes", told)
    done = []
    small = js.mistune(one, SPEEDS, progress=lambda *now: done.append(now), **how)
    assert lanes == [(4, 1, 6), (4, 2, 2)]  # a design without a random part and two patterns; the tuned row
    assert done[-1] == (32, 32)
    assert_alike(whole, small, 1e-9)
    stored = js.mistune(one, SPEEDS, store=tmp_path / "mistune.zarr", **how)
    lanes.clear()
    again = js.mistune(one, SPEEDS, store=tmp_path / "mistune.zarr", resume=True, **how)
    assert not lanes
    for found in (stored, again):
        assert_alike(small, found, 0)
    assert parse(small.scene, "again").scene.row.sector == "auto"
    assert {path.name for path in tmp_path.iterdir()} == {"mistune.zarr", "mistune_tuned.zarr"}
    with pytest.raises(CommandError, match="--force to replace it"):
        claimed_store(Namespace(out=tmp_path, resume=False, force=False))
    claimed_store(Namespace(out=tmp_path, resume=False, force=True))
    assert not list(tmp_path.iterdir())


UNLIKE = "row.mistuning differs"


def test_what_makes_blades_unlike_is_refused_by_verbs(tmp_path, monkeypatch, capsys):
    one, how = by_sector(ring()), {"n_periods": 1, "transient": 0, "method": METHOD}
    monkeypatch.setattr("jaxshroud.batch.runs.march_of", None)  # nothing is marched
    for asked in (
        lambda: js.scatter(one, {"row.mistuning": 0.01}, draws=2, **how),
        lambda: js.table(one, {"row.mistuning[3]": [0.0, 0.01]}, **how),
        lambda: js.tune(one, {"shroud.gap": (1e-5, 2e-5)}, scatters={"row.mistuning": 0.01}, **how),
        lambda: js.tune(one, {"row.mistuning[3]": (0.0, 0.01)}, **how),
    ):
        with pytest.raises(InputError, match=UNLIKE):
            asked()
    designs = tmp_path / "designs.csv"
    designs.write_text("row.mistuning[3]\n0\n0.01\n")
    for command in (
        f"table {designs} --scene row_ring12 --out {tmp_path}/out.csv",
        f"scatter row_ring12 --tolerance row.mistuning=0.01 --out {tmp_path}/out",
        f"tune row_ring12 --over row.mistuning[3]=0:0.01 --out {tmp_path}/out",
        f"tune row_ring12 --over shroud.gap=10um:20um --tolerance row.mistuning=0.01 --out {tmp_path}/out",
    ):
        assert UNLIKE in refused(capsys, f"{command} --set row.sector=auto")


@pytest.mark.full
@pytest.mark.parametrize("of", ["P_d_worst", "P", "x_rms"])
def test_designs_are_tuned_by_their_sector(of, monkeypatch):
    over = {"shroud.gap": (1e-5, 4e-5), "friction.mu": (0.2, 0.4)}
    small, whole = (one.scene for one in (by_sector(ring(*FOUR)), ring(*FOUR)))
    marched = []
    monkeypatch.setattr(
        "jaxshroud.verbs.gradient_ascent.run_flow",
        lambda scenes, *rest: marched.append(scenes.value.layout.blades) or run_flow(scenes, *rest),
    )
    plan = Plan(1, 2, 100, 0.0, choices(COARSE)._replace(amplitudes=of == "x_rms", precision="float64"))
    slopes = [
        exact_slopes(problem_of(scene, over, {}, None, of)._replace(plan=plan), np.array([[0.4, 0.6]]), id)[0]
        for scene in (small, whole)
    ]
    assert_allclose(slopes[0], slopes[1], rtol=1e-8)
    assert marched == [2, 2, 4, 4]


def test_other_starts_of_a_tuned_row_repeat_from_sector_to_sector():
    small, whole = (_perturbed_start(one.scene, np.random.default_rng(0)).motion for one in (by_sector(ring()), ring()))
    assert_array_equal(small.v_x, np.tile(small.v_x[:4], 3))
    assert np.ptp(whole.v_x.reshape(3, 4), axis=0).min() > 0


@pytest.mark.full
def test_a_search_finds_the_same_design():
    how = {"n_periods": 4, "transient": 4, "method": METHOD, "search": js.SearchOptions(4, 1, 1), "of": "x_rms"}
    whole = ring(*FOUR)
    one, other = (js.tune(scene, {"shroud.gap": (1e-5, 4e-5)}, **how) for scene in (by_sector(whole), whole))
    assert one.design["shroud.gap"] == pytest.approx(other.design["shroud.gap"], rel=1e-6)
    assert_allclose(one.scanned_scores, other.scanned_scores, rtol=1e-8)


PRESSED = ["shroud.gap=-0.4 mm", "drive.F_0=2", "drive.M_0=0", "friction.mu=0.9", "initial.start=static"]


@pytest.mark.full
@pytest.mark.parametrize("options", [[], ['parts.motion=["x","y","theta"]', "contact.points=2"]], ids=["x", "turns"])
def test_a_closed_form_is_that_of_the_whole_ring(options):
    whole, sector = (
        load("row_ring12", [*ALONG_X, *PRESSED, *options, *more]).scene for more in ([], ["row.sector=auto"])
    )
    found, one = (
        js.power(scene, n_periods=2, transient=0, linear="stuck", amplitudes=True, forces=True)
        for scene in (sector, whole)
    )
    for name in ("final_P", "x_peak", "N_max", "F_max"):
        assert_allclose(found.data[name], one.data[name], rtol=1e-10)
    # The gap moves all blades alike; the force on one blade does not, and is that of the whole ring.
    keys = ["shroud.gap", "friction.k_d", "drive.F_0[3]"]
    slopes, of_one = (js.gradient(scene, keys, of="P", linear="stuck").value for scene in (sector, whole))
    for key in keys:
        assert_allclose(slopes[key], of_one[key], rtol=1e-8, atol=1e-12 * abs(slopes["friction.k_d"]))
