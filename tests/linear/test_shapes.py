"""The table of modes from shapes of a solver or a test, in the forms in which they come, with their traps."""

import re
from pathlib import Path

import beam_model
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.io import savemat
from scipy.linalg import eigh

import jaxshroud as js
from jaxshroud.cli import commands

DIRECTIONS = (1, 2, 3)
ZETA = np.array([0.002, 0.003, 0.004, 0.005])


@pytest.fixture(scope="module")
def model():
    return beam_model.Model()


@pytest.fixture(scope="module")
def measured(model):
    """What a test of the blade gives: modes of any phase and scale, at the nodes of the shroud."""
    free = model.free
    squares, shapes = eigh(*(matrix[np.ix_(free, free)] for matrix in (model.K, model.M)))
    labels = [f"{tip}.{direction}" for tip in beam_model.TIPS for direction in DIRECTIONS]
    rows = [[model.labels[i] for i in free].index(label) for label in labels]
    mass = np.array([1.0, 4.0, 0.25, 1.0])
    phase = np.exp(1j * np.array([0.3, 1.6, -2.0, 3.0]))
    phi = shapes[rows, :4] * np.sqrt(mass) * phase
    nodes = {tip: model.nodes[tip] for tip in beam_model.TIPS}
    return {
        "f": np.sqrt(squares[:4]) / (2 * np.pi),
        "zeta": ZETA,
        "phi": phi,
        "mass": mass,
        "dofs": labels,
        "nodes": nodes,
        "shroud": beam_model.TIPS,
    }


@pytest.fixture(scope="module")
def wanted(model):
    return js.reduce(model.K, model.M, dofs=model.labels, nodes=model.nodes, shroud=beam_model.TIPS, fixed=["0"])


def products(phi):
    """What does not change with the signs of shapes."""
    return phi[:, None] * phi[None]


def test_complex_shapes_of_any_phase_and_scale_are_those_of_the_matrices(measured, wanted):
    blade = js.reduce_shapes(**measured, n_modes=3)
    assert_allclose(blade.f, wanted.f[:3], rtol=1e-7)  # of SciPy's, as the next
    assert_array_equal(blade.zeta, ZETA[:3])
    expected = products(wanted.phi[:, :3])
    assert_allclose(products(blade.phi), expected, rtol=1e-6, atol=1e-9 * expected.max())
    assert_allclose(blade.misfit, wanted.misfit[:3], rtol=1e-6)
    assert "1.000, 1.000, 1.000" in str(blade)
    # Control: the real parts as they stand are other shapes.
    plain = js.reduce_shapes(**measured | {"phi": measured["phi"].real}, n_modes=3)
    assert np.max(np.abs(products(plain.phi) - expected)) > 0.05 * expected.max()


def test_a_shape_that_is_no_real_mode_is_refused_unless_told(measured):
    phi = measured["phi"].copy()
    phi[::2, 2] *= 1j
    changed = measured | {"phi": phi}
    with pytest.raises(js.InputError, match=r"Mode 2 at .* is no real mode"):
        js.reduce_shapes(**changed)
    assert len(js.reduce_shapes(**changed, n_modes=2).f) == 2  # as it is not kept
    assert len(js.reduce_shapes(**changed, least_collinearity=0.0).f) == 4


def test_nodes_may_have_axes_of_their_own(measured):
    blade = js.reduce_shapes(**measured)
    x, y = np.array([0.0, 0.6, 0.8]), np.array([1.0, 0.0, 0.0])
    turn = np.stack([x, y, np.cross(x, y)])
    phi = measured["phi"].copy()
    phi[3:6] = turn @ phi[3:6]
    turned = measured | {"phi": phi}
    nodes = measured["nodes"] | {"102": np.concatenate([measured["nodes"]["102"], x, y])}
    found = js.reduce_shapes(**turned | {"nodes": nodes})
    assert_allclose(products(found.phi), products(blade.phi), rtol=1e-9, atol=1e-12)
    # Control: its neglect raises no error.
    assert np.max(js.reduce_shapes(**turned).misfit) > 10 * np.max(blade.misfit)


def test_what_is_no_mode_does_not_count(measured):
    # Two rigid motions, of which one has a negative omega^2; a residual vector among the modes; and one damped away.
    f = np.array([-1e-5, measured["f"][1], 2e-5, measured["f"][2]])
    zeta = np.array([0.002, 0.003, 0.004, 7.0])
    changed = measured | {"f": f, "zeta": zeta, "residual": [False, True, False, False]}
    blade = js.reduce_shapes(**changed, n_modes=2)
    assert_array_equal(blade.f, [0.0, 0.0, measured["f"][1]])
    assert blade.kind == ("mode", "mode", "residual")
    assert len(blade.blades(3).modes) == 3
    with pytest.raises(js.InputError, match=r"Mode 2 at .* is damped above critical"):
        js.reduce_shapes(**changed, n_modes=3)
    with pytest.raises(js.InputError, match="negative omega"):
        js.reduce_shapes(**changed | {"f": -f})


def test_a_stiff_residual_vector_makes_no_mode_rigid(measured, tmp_path):
    f = np.array([1.0, 2.0, 3.0, 1e4]) * measured["f"][0]
    blade = js.reduce_shapes(**measured | {"f": f, "residual": [0, 0, 0, 1]})
    assert_array_equal(blade.f, f)
    blade.save(tmp_path / "blade.csv")
    table = [f"blades.modes={tmp_path}/blade.csv", "contact.k=2e5"]
    assert float(js.load("table1", table).scene.blades.modes[0].f[0]) == f[0]
    # Control: of a mode it would.
    assert js.reduce_shapes(**measured | {"f": f}).f[0] == 0.0


def test_directions_that_were_not_measured_are_left_out(measured):
    phi = measured["phi"].copy()
    phi[2::3] = 0.0  # along z
    blade, whole = js.reduce_shapes(**measured | {"phi": phi}), js.reduce_shapes(**measured)
    assert_allclose(products(blade.phi), products(whole.phi), rtol=1e-6, atol=1e-6)
    phi[1::3] = 0.0
    with pytest.raises(js.InputError, match="do not determine its y"):
        js.reduce_shapes(**measured | {"phi": phi})


def test_shapes_are_checked_by_the_mass_where_that_is_given(model):
    free = model.free
    K, M = (matrix[np.ix_(free, free)] for matrix in (model.K, model.M))
    squares, shapes = eigh(K, M)
    given = {"dofs": [model.labels[i] for i in free], "nodes": model.nodes, "shroud": beam_model.TIPS, "M": M}
    blade = js.reduce_shapes(np.sqrt(squares[:3]) / (2 * np.pi), 0.0, shapes[:, :3], **given)
    assert len(blade.f) == 3
    with pytest.raises(js.InputError, match=r"Mode 1 at .* is not mass-normalised"):
        js.reduce_shapes(blade.f, 0.0, shapes[:, :3] * [1.0, 1.1, 1.0], **given)
    js.reduce_shapes(blade.f, 0.0, shapes[:, :3] * [1.0, 1.1, 1.0], mass=[1.0, 1.21, 1.0], **given)


WRONG = {
    "modes": ({"f": [1.0]}, "as many columns"),
    "rows": ({"dofs": ["1.1"]}, "must have 1 rows"),
    "numbers": ({"mass": 0.0}, "modal masses above 0"),
    "node": ({"shroud": ["999"]}, "names node 999"),
}


@pytest.mark.parametrize("case", WRONG)
def test_wrong_shapes_get_one_line(measured, case):
    changes, words = WRONG[case]
    f = measured["f"][:1] if case == "modes" else measured["f"]
    with pytest.raises(js.InputError, match=words) as caught:
        js.reduce_shapes(**measured | {"f": f, "zeta": [0.0, 0.0]} | changes if case == "modes" else measured | changes)
    assert "\n" not in str(caught.value)


def csv_of(measured):
    rows = {"f [Hz]": measured["f"], "zeta": measured["zeta"], "mass": measured["mass"]}
    rows |= {"kind": ["mode"] * 3 + ["residual"]}
    rows |= {
        label: [str(a).strip("()") for a in row] for label, row in zip(measured["dofs"], measured["phi"], strict=True)
    }
    return "\n".join(
        [",".join(["unknown", "1", "2", "3", "4"]), *(",".join([k, *map(str, v)]) for k, v in rows.items())]
    )


def written(measured, folder):
    """The file of the shapes in every form, by the words that name it."""
    rows = np.array([[float(node), *place] for node, place in measured["nodes"].items()])
    kind = ["mode"] * 3 + ["residual"]
    arrays = {name: measured[name] for name in ("f", "zeta", "mass", "phi")}
    cells = np.array([*measured["dofs"], None], object)[:-1, None]  # a column of cells of text
    np.savez(folder / "shapes.npz", dofs=measured["dofs"], nodes=rows, kind=kind, **arrays)
    savemat(folder / "shapes.mat", {**arrays, "dofs": cells, "nodes": rows, "kind": np.array(kind)})
    (folder / "nodes.txt").write_text("\n".join(" ".join(map(str, row)) for row in rows).replace(".0 ", " "))
    (folder / "shapes.csv").write_text(csv_of(measured))
    return {"npz": ["shapes.npz"], "mat": ["shapes.mat"], "csv": ["shapes.csv", "--nodes", "nodes.txt"]}


@pytest.mark.parametrize("form", ["npz", "mat", "csv"])
def test_the_command_reads_shapes(measured, tmp_path, monkeypatch, capsys, form):
    monkeypatch.chdir(tmp_path)
    words = ["reduce", *written(measured, tmp_path)[form], "--shroud", ",".join(beam_model.TIPS), "--modes", "2"]
    assert commands.main([*words, "--out", "blade.csv"]) == 0
    assert "Collinearity" in capsys.readouterr().out
    scene = js.load("table1", ["blades.modes=blade.csv", "contact.k=2e5"]).scene
    blade = js.reduce_shapes(**measured, residual=[0, 0, 0, 1], n_modes=2)
    modes = scene.blades.modes
    assert_allclose([mode.f[0] for mode in modes], blade.f, rtol=1e-12)
    assert_allclose([mode.zeta[0] for mode in modes], ZETA[[0, 1, 3]])
    found = np.array([[getattr(mode, f"phi_{name}")[0] for mode in modes] for name in ("x", "y", "theta")])
    assert_allclose(products(found), products(blade.phi), rtol=1e-9, atol=1e-12)
    # What concerns matrices alone is not passed over.
    for given in (["--fixed", "1"], ["--at-speed", "K.npz"], ["--no-residuals"]):
        assert commands.main([*words, *given, "--out", "other.csv"]) == 2
        assert f"{given[0]} is of matrices" in capsys.readouterr().err


def matlab_7_3(path, **arrays):
    """A file as MATLAB writes it since 7.3: HDF5 behind a head of 512 bytes, arrays transposed."""
    import h5py

    with h5py.File(path, "w", userblock_size=512) as file:
        for name, array in arrays.items():
            if array is None:
                file.create_group(name)
            else:
                file[name] = np.asarray(array).T
    with path.open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file".ljust(128))


@pytest.mark.parametrize("version", ["5", "7.3"])
def test_matrices_of_matlab(model, wanted, tmp_path, version):
    from jaxshroud.io.finite_element import read_model

    path, dofs = tmp_path / "blade.mat", np.array([[*map(float, label.split("."))] for label in model.labels])
    nodes = np.array([[float(node), *place] for node, place in model.nodes.items()])
    save = matlab_7_3 if version == "7.3" else lambda path, **arrays: savemat(path, arrays)
    unlike = model.K + np.triu(np.ones_like(model.K))  # shows whether it is transposed
    save(path, K=model.K, M=model.M, unlike=unlike, dofs=dofs, nodes=nodes)
    blade = js.reduce(**read_model([path]), shroud=beam_model.TIPS, fixed=["0"])
    assert_allclose(blade.f, wanted.f, rtol=1e-6)  # of a dense solver


def save_object(path):
    savemat(path, {"ROM": {"K": np.eye(2), "M": np.eye(2)}})


@pytest.mark.parametrize("save", [save_object, lambda path: matlab_7_3(path, ROM=None)], ids=["5", "7.3"])
def test_objects_of_matlab_are_refused_with_what_to_save(tmp_path, monkeypatch, capsys, save):
    monkeypatch.chdir(tmp_path)
    save(tmp_path / "rom.mat")
    assert commands.main(["reduce", "rom.mat", "--shroud", "1", "--out", "blade.csv"]) == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert "rom.mat: cannot be read as plain arrays (ROM is" in line
    assert "save -v7" in line


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("unknown,1\nf,100\n1.1,much\n", "a cell is a number"),
        ("unknown,1\nzeta,0.1\n1.1,1.0\n", "holds no f"),
        ("unknown,1\nf,100\n1.1,1.0,2.0\n", "no table below a head"),
        ("unknown,1\nf,100\n1.8,1.0\n", "direction from 1 to 6"),
        ("unknown,1\nf,100\n1.1,1.0\n1.1,1.0\n", "stands for two rows"),
        ("unknown,1\nf,100,200\n1.1,1.0\n", "shapes.csv"),
    ],
)
def test_wrong_files_of_shapes_get_one_line(tmp_path, monkeypatch, capsys, text, words):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "shapes.csv").write_text(text)
    (tmp_path / "nodes.txt").write_text("1 0 0 0\n")
    words_of_command = ["reduce", "shapes.csv", "--nodes", "nodes.txt", "--shroud", "1", "--out", "blade.csv"]
    assert commands.main(words_of_command) == 2
    assert words in capsys.readouterr().err.strip().splitlines()[-1]


def test_amplitudes_of_modes_have_no_place_in_a_singular_model(model):
    # Of a component by Craig and Bampton some unknowns are no motion of a node; rigid motions are named.
    K, M = (
        np.block([[a, np.zeros((len(a), 1))], [np.zeros((1, len(a))), 1e6 * np.eye(1)]]) for a in (model.K, model.M)
    )
    with pytest.raises(js.InputError, match=r"free to move as a whole \(x, y, z"):
        js.reduce(K, M, dofs=[*model.labels, "q1.1"], nodes=model.nodes, shroud=beam_model.TIPS)


def lines_of_the_page(word):
    """The block of code of docs/fem.md that imports a program."""
    text = (Path(__file__).parents[2] / "docs" / "fem.md").read_text("utf-8")
    (code,) = (block for block in re.findall(r"^```py\n(.*?)^```$", text, re.M | re.S) if word in block)
    return code


def test_the_lines_for_output4(tmp_path, monkeypatch):
    op4 = pytest.importorskip("pyyeti.nastran.op4", reason="pyyeti is not needed otherwise")
    monkeypatch.chdir(tmp_path)
    K = np.diag(np.arange(1.0, 25.0))
    op4.write("blade.op4", {"kxx": K, "mxx": np.eye(24)})
    exec(lines_of_the_page("pyyeti"), {})
    with np.load("blade.npz") as file:
        assert_array_equal(file["K"], K)
        assert file["dofs"][6] == "11.1"


def test_the_lines_for_uff(measured, tmp_path, monkeypatch):
    pyuff = pytest.importorskip("pyuff", reason="pyuff is not needed otherwise")
    monkeypatch.chdir(tmp_path)
    phi = measured["phi"].reshape(4, 3, 4)
    for j, f in enumerate(measured["f"]):
        root = 2 * np.pi * f * (-ZETA[j] + 1j * np.sqrt(1 - ZETA[j] ** 2))
        rows = {f"r{i + 1}": phi[:, i, j] for i in range(3)}
        whole = {
            "type": 55,
            "analysis_type": 3,
            "data_type": 5,
            "n_data_per_node": 3,
            "node_nums": [101, 102, 103, 104],
        }
        scale = {"mode_n": j + 1, "load_case": 1, "eig": root, "modal_a": 1j, "modal_b": 1.0}
        pyuff.UFF("blade.unv").write_sets(
            {**whole, **scale, **rows, "model_type": 1, "data_ch": 3, "spec_data_type": 8}, mode="add"
        )
    exec(lines_of_the_page("pyuff"), {})
    with np.load("blade.npz") as file:
        given = {name: file[name] for name in ("f", "zeta", "phi")}
        assert_allclose(given["zeta"], ZETA, rtol=1e-4)
        blade = js.reduce_shapes(**measured | given | {"dofs": [*map(str, file["dofs"])]})
    assert_allclose(products(blade.phi), products(js.reduce_shapes(**measured).phi), rtol=1e-3, atol=1e-4)
