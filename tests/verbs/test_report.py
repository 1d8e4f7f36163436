"""A report: its verdict, and documents that need nothing else."""

import re

import numpy as np
import pytest

import jaxshroud as js
from jaxshroud.results.pages import Section, html, pdf
from jaxshroud.verbs.report import gaps_about

SCENE = js.load("table1", ['parts.motion=["x"]', "blades.c_x=40", "drive.F_0=60"]).scene
SHORT = {"n_periods": 32, "transient": 64, "steps_per_period": 100, "starts": 4, "samples": 64}


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


def test_text_is_escaped_and_broken_into_pages():
    section = Section("<b>", ["a & b"], [["x", "y"], ["1", "2"]], verbatim="\n".join(map(str, range(200))))
    page = html("<title>", [section]).decode()
    assert "<b>" not in page
    assert "&lt;title&gt;" in page
    assert "a &amp; b" in page
    assert len(re.findall(rb"/Type /Page\b", pdf("t", [section]))) >= 3


@pytest.mark.parametrize(
    ("text", "typeset"),
    [
        ("M_0 = 0.1 N m", "<i>M</i><sub>0</sub> = 0.1 N m"),
        ("gamma = k / k_x", "<i>&gamma;</i> = <i>k</i> / <i>k</i><sub><i>x</i></sub>"),
        ("drive.F_0 by 2e-05", "<code>drive.F_0</code> by 2 &times; 10<sup>&minus;5</sup>"),
        ("P_d +- 3 m^2 & more", "<i>P</i><sub><i>d</i></sub> &plusmn; 3 m<sup>2</sup> &amp; more"),
        ("a steps_per_period of 5 $", "a steps_per_period of 5 $"),
    ],
)
def test_symbols_of_pages_are_typeset(text, typeset):
    assert typeset in html(text, [Section(text, [text], [[text], [text]])]).decode()
    assert html(text, [Section(text, [text], [[text], [text]])]).decode().count(f">{typeset}<") >= 5  # wherever it is
    assert b"/Type /Page" in pdf(text, [])


@pytest.mark.parametrize("gap", [2e-5, 0.0, -1e-5])
def test_gaps_are_about_the_design(gap):
    around = gaps_about(js.vary(SCENE, "shroud.gap", gap))
    assert np.all(np.diff(around) > 0)
    assert around[0] < gap < around[-1]


@pytest.mark.parametrize("limit", [{"most_force": 0.0}, {"most_penetration": -1.0}])
def test_limits_are_positive(limit):
    with pytest.raises(js.InputError, match="must be positive"):
        js.report(SCENE, **limit)
