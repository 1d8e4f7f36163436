"""A table of the load over one base period, fitted by harmonics."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

import jaxshroud as js
from jaxshroud.scene.config import load, parse
from jaxshroud.scene.load_table import fitted_table

ANGLES = np.arange(24) * 15.0
PARTS = {1: (20.0, -5.0), 2: (3.0, 4.0), 5: (0.0, 2.0)}  # with sines and cosines, N


def force(angle, parts):
    """The force at an angle in degrees."""
    tau = np.radians(angle)
    return 7.0 + sum(re * np.sin(n * tau) + im * np.cos(n * tau) for n, (re, im) in parts.items())


def written(folder, angles=ANGLES, head="angle [deg],F_x [N],M [N mm]", parts=PARTS):
    """A table of a force along x and of a moment of so many N mm."""
    path = folder / "pressure.csv"
    columns = np.asarray(angles).tolist(), force(np.asarray(angles), parts).tolist()
    rows = [f"{angle!r},{value!r},{2 * value!r}" for angle, value in zip(*columns, strict=True)]
    path.write_text("\n".join([head, *rows, ""]), encoding="utf-8")
    return path


def scene_text(harmonics=2):
    """A pair with a table in the place of its loads."""
    without = ("beta", "F_0", "M_0")
    lines = [line for line in load("table1").text().splitlines() if line.split(" = ")[0] not in without]
    at = lines.index("[drive]")
    return "\n".join([*lines[: at + 1], 'table = "pressure.csv"', f"harmonics = {harmonics}", *lines[at + 1 :]])


def test_harmonics_and_the_mean_of_a_table_are_found_to_rounding(tmp_path):
    rng = np.random.default_rng(3)
    for angles in (ANGLES, np.sort(rng.uniform(0, 360, 40)) + 1000):
        found = fitted_table(written(tmp_path, angles), 5)
        for n, (re, im) in {3: (0.0, 0.0), **PARTS}.items():
            for load_name, scale in (("F_x", 1.0), ("M", 2e-3)):
                entries = [found.entries[f"harmonic[{n - 1}].{load_name}_{part}"] for part in ("re", "im")]
                assert_allclose(entries, [scale * re, scale * im], rtol=0, atol=1e-12 * 25)
        assert found.entries["F_x_mean"] == pytest.approx(7.0, rel=1e-13)
        assert max(found.residuals.values()) < 1e-13


def test_what_harmonics_leave_out_is_told(tmp_path):
    # Of 20^2 + 5^2 + 3^2 + 4^2 + 2^2 two harmonics leave 2^2, at angles at equal distances.
    found = fitted_table(written(tmp_path), 2)
    assert_allclose(found.residuals["F_x"], np.sqrt(4 / 454), rtol=1e-12)
    (tmp_path / "own.toml").write_text(scene_text(), encoding="utf-8")
    assert load(str(tmp_path / "own.toml")).notes == {
        "load table": "2 harmonics leave 9.39 % of F_x, 9.39 % of M (RMS, about the mean)"
    }


def test_a_scene_with_a_table_is_driven_by_it(tmp_path):
    written(tmp_path, parts={n: PARTS[n] for n in (1, 2)})
    (tmp_path / "own.toml").write_text(scene_text(), encoding="utf-8")
    file = load(str(tmp_path / "own.toml"), ["parts.contact=none"])
    scene = js.vary(file.scene, "drive.phase", [0.0, 0.7])
    assert_allclose(scene.drive.F_x_mean, 7.0, rtol=1e-14)
    t = np.linspace(0, 1, 7) * float(scene.drive.period)
    degrees = np.degrees(float(scene.drive.omega) * t)
    for blade, phase in enumerate((0.0, 0.7)):
        loads = sum(
            np.sin(n * float(scene.drive.omega) * t) * re + np.cos(n * float(scene.drive.omega) * t) * im
            for n, one in scene.drive.harmonics().items()
            for re, im in [[float(a[blade]) for a in one.parts("x")]]
        )
        wanted = force(degrees + np.degrees(phase), {n: PARTS[n] for n in (1, 2)})
        assert_allclose(loads, wanted, rtol=0, atol=1e-12 * 25)
    # The written scene has the harmonics, and needs the table no more.
    again = parse(file.text(), "again.toml")
    assert again.text() == file.text()
    assert not again.notes


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (lambda text: text.replace("15.0,", "nan,", 1), r"row 3: angle = nan must be a finite number"),
        (lambda text: text.replace("15.0,", "360.0,", 1), r"two angles are alike, at 0 deg"),
        (lambda text: text + "360,999,999\n", r"two angles are alike, at 0 deg"),
        (lambda text: text.replace("[N]", "[mm]"), r"column F_x \[mm\]: its unit"),
        (lambda text: text.replace("F_x [N]", "F_x"), r"column F_x has no unit"),
        (lambda text: text.replace("F_x", "F_z"), r"column 'F_z \[N\]' is unknown"),
        (lambda text: "\n".join(text.splitlines()[:4]), r"has 3 angles; 2 harmonics need at least 5"),
        (lambda text: "\n".join(text.splitlines()[:7]), r"leave a part of the period out"),
        (lambda text: text.replace("\n15.0,", "\n15.0,1,", 1), r"row 3 has 4 cells"),
        (lambda text: "", r"needs a head"),
    ],
)
def test_a_table_that_cannot_be_is_refused_in_one_line(tmp_path, change, told):
    path = written(tmp_path)
    path.write_text(change(path.read_text(encoding="utf-8")), encoding="utf-8")
    (tmp_path / "own.toml").write_text(scene_text(), encoding="utf-8")
    with pytest.raises(js.SceneError, match=told) as error:
        load(str(tmp_path / "own.toml"))
    assert "\n" not in str(error.value)


def test_a_last_row_may_close_the_period(tmp_path):
    path = written(tmp_path)
    (tmp_path / "own.toml").write_text(scene_text(), encoding="utf-8")
    wanted = load(str(tmp_path / "own.toml"))
    first = path.read_text(encoding="utf-8").splitlines()[1]
    path.write_text(path.read_text(encoding="utf-8") + first.replace("0.0,", "360.0,", 1) + "\n", encoding="utf-8")
    assert load(str(tmp_path / "own.toml")).text() == wanted.text()


def test_a_path_with_a_nul_byte_is_refused(tmp_path):
    (tmp_path / "own.toml").write_text(scene_text().replace("pressure", r"pres\u0000sure"), encoding="utf-8")
    with pytest.raises(js.SceneError, match=r"pres\\0sure.csv: cannot be read \(embedded null byte\); give a CSV file"):
        load(str(tmp_path / "own.toml"))


def test_a_table_stands_alone(tmp_path):
    (tmp_path / "own.toml").write_text(scene_text(), encoding="utf-8")
    with pytest.raises(js.SceneError, match=r"pressure.csv: no such file; give a CSV file with a head"):
        load(str(tmp_path / "own.toml"))
    written(tmp_path)
    for key, value in (("drive.F_0", "3"), ("drive.F_x_mean", "1")):
        with pytest.raises(js.SceneError, match=r"\[drive\] gives both `table` and"):
            load(str(tmp_path / "own.toml"), [f"{key}={value}"])
    with pytest.raises(js.SceneError, match=r"\[drive\] harmonics = 0 must be from 1 to 99"):
        load(str(tmp_path / "own.toml"), ["drive.harmonics=0"])
