"""The parts of the page of `explore`: what it computes and compiles, what it refuses, and the package without it."""

import ast
import io
import pickle
import stat
import subprocess
import sys
import threading
import types
from pathlib import Path

import jax.monitoring
import markupsafe
import numpy as np
import psutil
import pytest
from bokeh.document import Document

import jaxshroud as js
from jaxshroud.cli import commands
from jaxshroud.cli import explore as command
from jaxshroud.explorer.centre import Centre
from jaxshroud.explorer.controls import Controls
from jaxshroud.explorer.diagram import Amount, Window, diagram, joined
from jaxshroud.explorer.engine import Message, Service
from jaxshroud.explorer.exploration import Exploration, in_si, method_on_page, number_fields
from jaxshroud.explorer.jobs import Methods, Outdated, RunWish
from jaxshroud.explorer.panels import DiagramPanel
from jaxshroud.explorer.saves import STATIC_ROOTS, static_page
from jaxshroud.explorer.server import redirecting_file
from jaxshroud.explorer.styles import Recolouring, root
from jaxshroud.model.modes import Status
from jaxshroud.scene.checks import InputError, SceneError
from jaxshroud.scene.keys import ALL_KEYS
from jaxshroud.scene.text import read_shown, shown_text

ROOT = Path(js.__file__).parent
OF_THE_EXTRA = {"bokeh", "tornado", "jinja2"}
SMALL = ['parts.motion=["x"]', "blades.c_x=40"]
METHOD = js.RungeKutta(steps=100)


@pytest.fixture(scope="module")
def exploration():
    return Exploration(js.load("table1", SMALL).text(), "table1", tuple(SMALL))


WINDOW = Window("contact.gamma", 1.0, 3.0)


def diagram_of(exploration, values):
    """Short runs at some values of the window."""
    return diagram(exploration.file, WINDOW, values, "independent", Amount(1, 2), METHOD, lambda done, total: None)


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


@pytest.mark.full
def test_levels_that_are_joined_are_the_sweep_of_all_values(exploration):
    parts = joined([diagram_of(exploration, WINDOW.new_values(level, 3)) for level in (0, 1)])
    whole = diagram_of(exploration, WINDOW.values(1, 3))
    for name in ("P_d", "period_number", "status", "x_peak"):
        np.testing.assert_array_equal(getattr(parts, name), getattr(whole, name))
    np.testing.assert_array_equal(parts.motion.x, whole.motion.x)
    assert parts.axes.keys() == whole.axes.keys()


@pytest.mark.release
@pytest.mark.full
def test_a_slider_compiles_nothing(exploration):
    """Other numbers of one structure run by the programs that are there."""
    compiled = []
    listen = lambda event, seconds, **more: compiled.append(event) if "backend_compile" in event else None

    def compute(one):
        diagram_of(one, WINDOW.values(0, 4))
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


@pytest.mark.full
def test_a_lane_that_stopped_is_shown_as_such(exploration):
    result = diagram_of(exploration, WINDOW.values(0, 3))
    result.data["status"][1] = int(Status.NOT_FINITE)
    panel = DiagramPanel(Recolouring(), lambda start, stop: None, lambda value: None)
    panel.show_window(WINDOW)
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
            # What a slider gives is, in the unit that it shows, a number with few digits, as one would type it.
            assert len(shown_text(field.key, in_si(field.key, field.low + 7 * field.step))) < 14


class Fields:
    """The fields of a scene as on its page, and what they changed."""

    def __init__(self, *sets):
        self.exploration = Exploration(js.load("table1", sets).text(), "table1", sets)
        self.controls = Controls(self.exploration, self.change, "fast")

    def change(self, key, text):
        self.exploration = self.exploration.changed(key, text)
        self.controls.show(self.exploration)

    def type(self, key, text):
        """Type into the field of a key: what the scene has then, what the field shows, and what it says."""
        field = self.controls.fields[key]
        field.text.value = text
        table, name = key.split(".")
        return self.exploration.file.given_tables[table][name], field.text.value, field.message.text


def test_a_field_reads_what_it_shows_also_with_a_number_per_blade():
    fields = Fields("drive.beta=[0.5, 0.6]", "blades.k_x=[1e5, 1.2e5]")
    shown = {key: fields.controls.fields[key].text.value for key in ("drive.beta", "blades.k_x")}
    assert shown == {"drive.beta": "[28.64788975654116, 34.37746770784939]", "blades.k_x": "[100, 120]"}
    for key, text in shown.items():
        value = fields.type(key, "1")[0]
        assert value == read_shown(ALL_KEYS[key], "1")
        assert fields.type(key, text)[1:] == (text, "")
    assert fields.exploration.file.given_tables["drive"]["beta"] == (0.5, 0.6)
    assert fields.exploration.file.given_tables["blades"]["k_x"] == (1e5, 1.2e5)
    assert fields.type("drive.beta", "34") == (np.float64(34 * np.pi / 180), "34", "")


@pytest.mark.parametrize(
    ("key", "text", "said"),
    [
        ("friction.mu", "-5", "mu = -5 must be greater than or equal to 0; 0.5 is kept"),
        ("shroud.alpha", "120", "alpha = 120 must be less than or equal to 90.0 °; 60 is kept"),
        ("shroud.alpha", "120 deg", "alpha = 120 deg must be less than or equal to 90.0 °; 60 is kept"),
        ("blades.k_x", "0", "k_x = 0 must be greater than 0 kN/m; 100 is kept"),
        ("blades.c_x", "3,57", "has a comma: the decimal mark is a point"),
        ("drive.beta", "1,5", "has a comma: the decimal mark is a point"),
        ("shroud.gap", "[1, 2, 3]", "must be"),
        ("shroud.gap", "1e400", "must be a finite number"),
        ("shroud.gap", "<b>1</b>", "&lt;b&gt;1&lt;/b&gt;"),
    ],
)
def test_what_a_field_does_not_take_it_says_and_nothing_changes(key, text, said):
    fields = Fields()
    before = fields.exploration
    _, shown, told = fields.type(key, text)
    assert said in told
    assert shown == text  # as it was typed, beside what is wrong with it
    assert fields.exploration is before


@pytest.mark.parametrize("text", ["1e308", "-1e305", "1e-320", "5e-324", "1e300"])
def test_after_an_absurd_number_the_fields_live_on(text):
    """What no slider can show is shown as text, and later changes are taken."""
    fields = Fields()
    for key in ("shroud.gap", "drive.F_0", "blades.c_x"):
        value, _, said = fields.type(key, text)
        assert said or value == read_shown(ALL_KEYS[key], text)
        assert fields.type(key, "0.25")[0] == read_shown(ALL_KEYS[key], "0.25")
        assert fields.controls.fields[key].message.text == ""


def test_an_end_of_the_window_reads_as_it_is_shown(exploration):
    """Another end that is typed leaves this one as it was, to the last bit."""
    owner = types.SimpleNamespace(exploration=exploration, compute_diagram=lambda: None)
    centre = Centre(exploration, Recolouring(), owner)
    start, stop = 1 / 3, 7 / 3
    centre._show_window(Window("contact.gamma", start, stop))
    centre.ends[1].value = "2"
    assert centre.window == Window("contact.gamma", start, 2.0)
    centre.ends[0].value = "0,5"
    assert "has a comma" in centre.wrong.text
    assert centre.window == Window("contact.gamma", start, 2.0)


def test_a_heading_is_text_whatever_is_in_it():
    document, markup = Document(), '<img src=x onerror="window.ran=1"><script>window.ran=1</script>&amp;'
    for name in STATIC_ROOTS:
        document.add_root(root(name))
    html = static_page(document, markup, dark=False).decode()
    assert "<img src=x" not in html
    assert "<script>window.ran" not in html
    assert f"<h1>{markupsafe.escape(markup)}</h1>" in html


def test_the_browser_is_told_the_address_by_a_file_that_others_cannot_read(monkeypatch, tmp_path):
    for place in (None, str(tmp_path)):
        monkeypatch.setenv("XDG_RUNTIME_DIR", place) if place else monkeypatch.delenv("XDG_RUNTIME_DIR", raising=False)
        with redirecting_file("http://127.0.0.1:5/secret") as path:
            assert stat.S_IMODE(path.stat().st_mode) == 0o600
            assert stat.S_IMODE(path.parent.stat().st_mode) == 0o700
            assert 'content="0; url=http://127.0.0.1:5/secret"' in path.read_text()
        assert not path.parent.exists()


@pytest.mark.parametrize(
    "sets",
    [["drive.omega=1e-6"], ["contact.gamma=1e12"], ["friction.k_d=1e25"], ["contact.gamma=1e30"], ["blades.m=1e-30"]],
)
def test_no_method_is_tried_on_numbers_that_a_page_cannot_march(exploration, sets):
    def tried():
        raise AssertionError("tried")

    with pytest.raises(InputError, match=r"to march them|vibrations of the stiffest spring, and a page at most"):
        method_on_page(js.load("table1", [*SMALL, *sets]), "fast", tried)


def test_the_choice_of_a_method_ends_before_its_next_trial(exploration):
    def outdated():
        raise Outdated

    methods = Methods()
    with pytest.raises(Outdated):
        methods.method(exploration, "fast", outdated)
    assert methods.known(exploration, "fast") is None  # and nobody waits for it


def test_an_engine_answers_with_what_the_verbs_give(exploration):
    """Wishes and answers go through pickle, as between processes; a later wish replaces an earlier one."""
    answers, wishes, wanted = io.BytesIO(), io.BytesIO(), (exploration, "fast")
    for message in (
        Message("learn", content=(*wanted, METHOD)),
        Message("submit", "run", 1, (RunWish(exploration, wanted, 1),)),
    ):
        wishes.write(pickle.dumps(message))
    wishes.seek(0)
    ended = threading.Semaphore(0)
    service = Service(answers, ended.release)
    service.serve(wishes)
    assert ended.acquire(timeout=600)
    for worker in service.workers.values():
        worker.close()
    answers.seek(0)
    answer = pickle.load(answers)
    assert answer[:3] == ("show", "run", 1)
    expected = js.simulate(exploration.file, n_periods=1, method=METHOD)
    np.testing.assert_array_equal(answer.content[0].motion.x, expected.motion.x)


def test_an_engine_ends_with_the_process_that_started_it():
    # An engine that only waits: its input is closed when the process that holds it has gone.
    code = """import sys, time
from jaxshroud.explorer.engine import Engine
engine = Engine([sys.executable, "-c", "import sys; sys.stdin.read()"])
print(engine.process.pid, flush=True)
time.sleep(600)"""
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True) as holder:
        engine = psutil.Process(int(holder.stdout.readline()))
        holder.kill()
    engine.wait(timeout=60)


def test_what_is_copied_is_the_scene(exploration):
    later = exploration.changed("shroud.gap", "3e-05")
    assert later.command("sweep", "--num", "3").startswith("jaxshroud sweep table1 --set 'parts.motion=[\"x\"]'")
    assert "--set shroud.gap=3e-05" in later.command("sweep")
    again = js.load("table1", [*SMALL, "shroud.gap=3e-05"])
    assert again.tables == later.file.tables
