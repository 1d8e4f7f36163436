"""The parts of the page of `explore`: what it computes and compiles, what it refuses, and the package without it."""

import ast
from pathlib import Path

import jax.monitoring
import numpy as np
import pytest

import jaxshroud as js
from jaxshroud.cli import commands
from jaxshroud.cli import explore as command
from jaxshroud.explorer.diagram import Amount, Window, diagram, joined
from jaxshroud.explorer.diagram_panel import DiagramPanel
from jaxshroud.explorer.exploration import Exploration
from jaxshroud.explorer.fields import number_fields
from jaxshroud.explorer.look import Recolouring
from jaxshroud.model.modes import Status
from jaxshroud.scene.checks import SceneError

ROOT = Path(js.__file__).parent
OF_THE_EXTRA = {"bokeh", "tornado", "jinja2"}
SMALL = ['parts.motion=["x"]', "blades.c_x=40"]
METHOD = js.RungeKutta(steps=100)


@pytest.fixture(scope="module")
def exploration():
    return Exploration(js.load("table1", SMALL).text(), "table1", tuple(SMALL))


def imports(nodes):
    """The first names of what statements import."""
    for node in nodes:
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield str(node.module)


def test_nothing_outside_of_explore_imports_what_only_the_extra_brings():
    paths = [path for path in ROOT.rglob("*.py") if path.parent.name != "explorer"]
    used = {
        path.name: {name.split(".")[0] for name in imports(ast.walk(ast.parse(path.read_text())))} for path in paths
    }
    assert not {name for name, found in used.items() if found & OF_THE_EXTRA}
    on_top = list(imports(ast.parse(Path(command.__file__).read_text()).body))
    assert not [name for name in on_top if name.startswith("jaxshroud.explorer")]
    # Control: the scan sees what the page imports.
    page = ast.parse((ROOT / "explorer" / "page.py").read_text())
    assert {name.split(".")[0] for name in imports(ast.walk(page))} & OF_THE_EXTRA


def test_without_bokeh_the_command_says_how_to_get_it(monkeypatch, capsys):
    monkeypatch.setattr(command, "find_spec", lambda name: None)
    assert commands.main(["explore", "table1", "--no-browser"]) == 1
    assert 'pip install "jaxshroud[explore]"' in capsys.readouterr().err


def test_a_finer_level_keeps_the_values_of_the_one_before():
    # 1/3 and 1/7 are no binary fractions: a grid that were rounded differently would show.
    for ends in ((0.0, 8.0), (1 / 3, 1 / 7), (-2e-5, 2.2e-5)):
        window = Window("shroud.gap", *ends)
        for level in (1, 2):
            fine = window.values(level)
            assert (fine[::2] == window.values(level - 1)).all()
            assert (fine[1::2] == window.new_values(level)).all()


def test_levels_that_are_joined_are_the_sweep_of_all_values(exploration):
    window, length, quiet = Window("contact.gamma", 1.0, 3.0), Amount(1, 2), lambda done, total: None
    run = lambda values: diagram(exploration.file, window, values, "independent", length, METHOD, quiet)
    parts = joined([run(window.new_values(level, 3)) for level in (0, 1)])
    whole = run(window.values(1, 3))
    for name in ("P_d", "period_number", "status", "x_peak"):
        np.testing.assert_array_equal(getattr(parts, name), getattr(whole, name))
    np.testing.assert_array_equal(parts.motion.x, whole.motion.x)
    assert parts.axes.keys() == whole.axes.keys()


def test_a_slider_compiles_nothing(exploration):
    """Other numbers of one structure run by the programs that are there."""
    compiled = []
    listen = lambda event, seconds, **more: compiled.append(event) if "backend_compile" in event else None
    window, quiet = Window("contact.gamma", 1.0, 3.0), lambda done, total: None

    def compute(one):
        diagram(one.file, window, window.values(0, 4), "independent", Amount(1, 2), METHOD, quiet)
        js.simulate(one.file, n_periods=1, method=METHOD)

    compute(exploration)
    jax.monitoring.register_event_duration_secs_listener(listen)
    try:
        compute(exploration.changed("shroud.gap", "3e-5").changed("drive.F_0", "50.0").changed("friction.mu", "0.3"))
        assert not compiled
        js.simulate(exploration.changed("parts.friction", '"none"').file, n_periods=1, method=METHOD)
        assert compiled  # control: another structure is another program
    finally:
        jax.monitoring.unregister_event_duration_listener(listen)


def test_a_wrong_value_is_refused_with_the_place_and_the_cure(exploration):
    for key, text, said in (("friction.mu", "-1", "greater than or equal to 0"), ("shroud.gap", "3 kg", "kg")):
        with pytest.raises(SceneError, match=said):
            exploration.changed(key, text)
    assert exploration.changed("shroud.gap", "30 um").file.tables["shroud"]["gap"] == pytest.approx(3e-5)


def test_a_lane_that_stopped_is_shown_as_such(exploration):
    window, quiet = Window("contact.gamma", 1.0, 3.0), lambda done, total: None
    result = diagram(exploration.file, window, window.values(0, 3), "independent", Amount(1, 2), METHOD, quiet)
    result.data["status"][1] = int(Status.NOT_FINITE)
    panel = DiagramPanel(Recolouring(), lambda start, stop: None, lambda value: None)
    panel.show_window(window)
    panel.show_level(0, result, result)
    assert panel.stopped.data["shown"].tolist() == [2.0]
    assert panel.lanes.data["status"] == ["OK", "NOT_FINITE", "OK"]
    assert np.isnan(panel.lanes.data["P_d"]).tolist() == [False, True, False]
    assert 2.0 not in panel.samples[0].data["value"]
    assert "1 lanes stopped: NOT_FINITE" in panel.legend.text


@pytest.mark.parametrize("name", ["fig09_best", "engine_order", "row_chain5", "dry_friction_2dof"])
def test_every_slider_stays_within_the_range_of_its_number(name):
    file = js.load(name)
    for field in number_fields(file):
        if field.value is not None:
            assert field.low <= field.value <= field.high or field.key.name in {a.key for a in file.axes}
            assert all(field.key.range.holds(np.float64(end)) for end in field.ends), field
            # What a slider gives is a number with few digits, as one would type it.
            assert len(repr(field.in_si(field.low + 7 * field.step)).replace(".", "")) < 14


def test_what_is_copied_is_the_scene(exploration):
    later = exploration.changed("shroud.gap", "3e-05")
    assert later.command("sweep", "--num", "3").startswith("jaxshroud sweep table1 --set 'parts.motion=[\"x\"]'")
    assert "--set shroud.gap=3e-05" in later.command("sweep")
    again = js.load("table1", [*SMALL, "shroud.gap=3e-05"])
    assert again.tables == later.file.tables
