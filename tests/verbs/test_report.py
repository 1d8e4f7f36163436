"""A report: its verdict, and documents that need nothing else."""

import base64
import re
import sys
from types import SimpleNamespace

import numpy as np
import pytest
from matplotlib.figure import Figure

import jaxshroud as js
from jaxshroud.plotting.documents import Section, html_document, pdf_document, save_document
from jaxshroud.results.tuned import DesignJudgement
from jaxshroud.verbs.report import gaps_about
from jaxshroud.verbs.report_sections import Limits, ReportData

verb = sys.modules["jaxshroud.verbs.report"]  # `jaxshroud.verbs` may hold the function of that name

SCENE = js.load("table1", ['parts.motion=["x"]', "blades.c_x=40", "drive.F_0=60"]).scene
SHORT = {"n_periods": 32, "transient": 64, "method": js.RungeKutta(steps=100), "starts": 4, "draws": 64}


@pytest.mark.release
@pytest.mark.full
def test_a_report_judges_by_what_is_asked(tmp_path):
    scatters = {"shroud.gap": (1e-5, 3e-5)}
    calm = js.report(SCENE, scatters=scatters, conditions={"drive.F_0": [50.0, 60.0]}, at_least=1.0, **SHORT)
    assert calm.verdict == "sound", calm.reasons
    calm.save(tmp_path / "report.html")
    calm.save(tmp_path / "report.pdf")
    page = (tmp_path / "report.html").read_text("utf-8")
    for number in (f"{float(calm.run.P_d):.5g}", f"{float(calm.run.N_max):.5g}", f"{calm.scatter.median:.4g}"):
        assert number[:4] in page
    assert not re.search(r"https?://|<script|<link", page)
    assert (tmp_path / "report.pdf").read_bytes().startswith(b"%PDF")
    harsh = js.report(SCENE, scatters=scatters, at_least=99.0, most_force=1e-3, most_penetration=1e-9, **SHORT)
    assert harsh.verdict == "fails"
    assert len(harsh.reasons) >= 4  # P_d, force, penetration, probability
    with pytest.raises(js.InputError, match=r"\.html or \.pdf"):
        calm.save(tmp_path / "report.doc")


@pytest.mark.release
@pytest.mark.full
def test_a_report_in_conditions_is_of_these():
    scatters, conditions = {"shroud.gap": (1e-5, 3e-5)}, {"drive.F_0": [50.0, 100.0]}
    short = SHORT | {"draws": 4}
    found = js.report(js.vary(SCENE, "drive.F_0", 20.0), scatters=scatters, conditions=conditions, **short)
    # Everything is as if the scene had the conditions' F_0: P_d and its scatter, sensitivities, motions, forces.
    run_for = {name: short[name] for name in ("n_periods", "transient", "method")}
    in_each = js.sweep(SCENE, conditions, forces=True, **run_for)
    worst = int(np.argmin(in_each.P_d))
    at = js.vary(SCENE, "drive.F_0", conditions["drive.F_0"][worst])
    assert float(found.run.P_d) == pytest.approx(in_each.P_d[worst], rel=1e-9)
    spread = js.scatter(SCENE, scatters, conditions=conditions, draws=4, **run_for)
    assert found.scatter.median == pytest.approx(spread.median, rel=1e-9)
    slopes = js.gradient(at, ["shroud.gap"], **run_for)
    assert found.gradient.value["shroud.gap"] == pytest.approx(slopes.value["shroud.gap"], rel=1e-6)
    assert len(found.coexisting) == 2
    P_d = [motions.P_d[0] for motions in found.coexisting]
    np.testing.assert_allclose(P_d, in_each.P_d, rtol=1e-6)
    np.testing.assert_array_equal(found.attractors.P_d, found.coexisting[worst].P_d)
    told = {section.heading: section for section in found.sections}
    for name in ("Verdict", "Data sheet", "Operating conditions", "Over the gap", "Scatter", "Sensitivity"):
        section = told[name]
        text = " ".join([*section.paragraphs, *(cell for row in section.table for cell in row)])
        assert re.search(r"drive\.F_0 = (50|100)", text), name
    assert [row[0] for row in told["Coexisting motions"].table] == ["drive.F_0", "50", "100"]
    # The largest force is that of all runs shown.
    printed = dict(row[:2] for row in told["Verdict"].table)["largest normal force of all runs"]
    shown = [float(row[2]) for row in told["Checks"].table[1:]] + [float(in_each.N_max.max()), found.scatter.N_max]
    assert float(printed.split()[0]) == pytest.approx(max(shown), rel=1e-4)  # five digits


def report_data(**more):
    """The data of a report, so far as forces go."""
    nothing = dict.fromkeys(DesignJudgement._fields, np.zeros(1))
    judged = lambda force, v_max, P_d: DesignJudgement(
        **{**nothing, "force": np.array([force]), "v_max": np.array([v_max]), "P_d": np.array([P_d])}
    )
    run = lambda N, F, v: SimpleNamespace(N_max=np.array(N), F_max=np.array(F), v_max=np.array(v))
    fields = {
        "sheets": [],
        "limits": Limits(),
        "conditions": {"drive.F_0": [50.0, 60.0]},
        "rows": np.array([[50.0], [60.0]]),
        "judged": judged(188.4, 1e-3, [51.0, 50.0]),
        "checks": {"four times as long": judged(196.2, 1.1e-3, [51.0, 50.0])},
        "runs": run([180.0, np.nan], [90.0, 80.0], [9e-4, 8e-4]),
        "over_gap": None,
        "spread": run(198.4, None, 1.2e-3),
        "slopes": None,
        "motions": [],
        "on_motions": [None, run([150.0, 151.0], [95.0, 20.0], [7e-4, 7e-4])],
    }
    fields["findings"] = SimpleNamespace(friction=None)
    return ReportData(**(fields | more))


def test_the_largest_force_is_that_of_all_runs_shown():
    data = report_data()
    assert (data.force, data.friction, data.penetration) == (198.4, 95.0, 1.2e-3)
    assert report_data(spread=None).force == 196.2
    assert data.where(data.worst) == "drive.F_0 = 60"


def test_text_is_escaped_and_broken_into_pages():
    section = Section("<b>", ["a & b"], [["x", "y"], ["1", "2"]], verbatim="\n".join(map(str, range(200))))
    page = html_document("<title>", [section]).decode()
    assert "<b>" not in page
    assert "&lt;title&gt;" in page
    assert "a &amp; b" in page
    assert len(re.findall(rb"/Type /Page\b", pdf_document("t", [section]))) >= 3


@pytest.mark.parametrize("dpi", [50, 120])
def test_pictures_have_the_dots_per_inch(tmp_path, dpi):
    save_document("t", [Section("s", figure=Figure((2, 1)))], tmp_path / "report.html", dpi)
    (content,) = re.findall(r"base64,([^\"]+)", (tmp_path / "report.html").read_text("utf-8"))
    assert int.from_bytes(base64.b64decode(content)[16:20]) == 2 * dpi


@pytest.mark.parametrize(
    ("text", "typeset"),
    [
        ("M_0 = 0.1 N m", "<i>M</i><sub>0</sub> = 0.1 N m"),
        ("gamma = k / k_x", "<i>&gamma;</i> = <i>k</i> / <i>k</i><sub><i>x</i></sub>"),
        ("drive.F_0 by 2e-05", "<code>drive.F_0</code> by 2 &times; 10<sup>&minus;5</sup>"),
        ("P_d +- 3 m^2 & more", "<i>P</i><sub><i>d</i></sub> &plusmn; 3 m<sup>2</sup> &amp; more"),
        ("a steps_per_period of 5 $", "a steps_per_period of 5 $"),
        (r"$\frac{1}$ to M_0", r"$\frac{1}$ to <i>M</i><sub>0</sub>"),
    ],
)
def test_symbols_of_pages_are_typeset(text, typeset):
    document = html_document(text, [Section(text, [text], [[text], [text]])]).decode()
    assert document.count(f">{typeset}<") >= 5  # wherever it is
    assert b"/Type /Page" in pdf_document(text, [Section(text, [text], verbatim=text)])


@pytest.mark.parametrize("gap", [2e-5, 0.0, -1e-5])
def test_gaps_are_about_the_design(gap):
    around = gaps_about(js.vary(SCENE, "shroud.gap", gap))
    assert np.all(np.diff(around) > 0)
    assert around[0] < gap < around[-1]


class BegunError(Exception):
    """A run of the report has begun."""


@pytest.fixture
def nothing_runs(monkeypatch):
    """The first run of a report raises an error."""

    def run(*_, **__):
        raise BegunError

    monkeypatch.setattr(verb, "sweep", run)


SCATTERS = {"shroud.gap": (1e-5, 3e-5)}
REFUSED = [
    ({"most_force": 0.0}, "`most_force` must be positive"),
    ({"most_penetration": -1.0}, "`most_penetration` must be positive"),
    ({"at_least": np.nan}, "`at_least` must be a number"),
    ({"starts": 0}, "`starts` must be positive"),
    ({"seed": -1}, "`seed` must be a whole number"),
    ({"scatters": SCATTERS, "draws": 1}, "`draws` must be"),
    ({"scatters": SCATTERS, "draws": 2**30}, "lane-periods"),
    ({"scatters": {"shroud.gab": (1e-5, 2e-5)}}, "did you mean `shroud.gap`"),
    ({"scatters": {"shroud.gap": (2e-5, 1e-5)}}, "must be finite and in order"),
    ({"scatters": {"friction.mu": (-0.1, 0.1)}}, "friction.mu, at its bounds, = -0.1 must be"),
    ({"scatters": {"contact.k": (1e5, 2e5), "contact.gamma": (1.0, 2.0)}}, "are one number"),
    ({"scatters": {"contact.gamma": (1.0, 5000.0)}}, "use at least"),
    ({"conditions": {"drive.F0": [1.0]}}, "did you mean `drive.F_0`"),
    ({"conditions": {"drive.F_0": []}}, "drive.F_0 has no value"),
    ({"conditions": {"friction.mu": [-1.0]}}, "friction.mu, as an operating condition, = -1 must be"),
    ({"conditions": {"drive.F_0": [np.nan]}}, "must be a finite number"),
    ({"conditions": {"drive.F_0": [0.0, 10.0]}}, "does not vibrate without contact"),
    ({"n_periods": 10**9}, "lane-periods"),
]


@pytest.mark.parametrize(("arguments", "message"), REFUSED, ids=[message for _, message in REFUSED])
def test_wrong_arguments_are_refused_before_anything_runs(arguments, message, nothing_runs):
    with pytest.raises(js.InputError, match=re.escape(message)):
        js.report(SCENE, **{"n_periods": 2, "transient": 2, "method": js.RungeKutta(steps=100), **arguments})


def test_valid_arguments_are_accepted(nothing_runs):
    with pytest.raises(BegunError):
        js.report(SCENE, scatters=SCATTERS, conditions={"drive.F_0": [50.0, 60.0]}, at_least=1.0, **SHORT)
