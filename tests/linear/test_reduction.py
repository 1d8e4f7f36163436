"""Modes and residual vectors from matrices of finite elements, against the whole matrices."""

import dataclasses
from functools import partial

import beam_model
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.io import mmwrite, savemat
from scipy.linalg import eigh
from scipy.sparse import coo_array, csc_array, save_npz
from solid_blade import solid_blade

import jaxshroud as js
from jaxshroud.cli import commands
from jaxshroud.linear.reduction import stiffness_factor, symmetric

K_CONTACT, L_OA, ALPHA = 2e6, 0.04, np.radians(60.0)
FREQUENCIES = np.linspace(50, 900, 60)


@pytest.fixture(scope="module")
def model():
    return beam_model.Model()


def reduce(model, **changes):
    given = {"dofs": model.labels, "nodes": model.nodes, "shroud": beam_model.TIPS, "fixed": ["0"], "zeta": 0.002}
    return js.reduce(**({"K": model.K, "M": model.M} | given | changes))


def whole(model):
    """K, M and the map to the shroud of the unknowns that are free."""
    free = model.free
    return model.K[np.ix_(free, free)], model.M[np.ix_(free, free)], model.shroud()[:, free]


def flexibility(blade):
    return (blade.phi / (2 * np.pi * blade.f) ** 2) @ blade.phi.T


def stuck_springs():
    """The stiffness (3, 3) at the shroud of a blade whose neighbour moves against it, stuck at the upper corner."""
    s, c = np.sin(ALPHA), np.cos(ALPHA)
    corner = np.array([L_OA / 2 + 0.01 * c, 0.01 * s])
    rows = [np.array([*n, corner[1] * n[0] - corner[0] * n[1]]) for n in ((s, -c), (c, s))]
    return 2 * K_CONTACT * sum(np.outer(row, row) for row in rows)


def stuck_of_blade(blade):
    phi = blade.phi
    squares, _ = np.linalg.eigh(np.diag((2 * np.pi * blade.f) ** 2) + phi.T @ stuck_springs() @ phi)
    return np.sqrt(squares) / (2 * np.pi)


def stuck_of_model(model):
    K, M, B = whole(model)
    return np.sqrt(eigh(K + B.T @ stuck_springs() @ B, M, eigvals_only=True)) / (2 * np.pi)


def response_of_blade(blade, f):
    omega, own = 2 * np.pi * f, 2 * np.pi * blade.f
    H = (blade.phi / (own**2 - omega**2 + 2j * blade.zeta * own * omega)) @ blade.phi.T
    return np.linalg.solve(np.eye(3) + H @ stuck_springs(), H @ [1.0, 0.5, 0.01])


def response_of_model(model):
    """The displacements of the shroud at all frequencies, with damping of all its modes."""
    K, M, B = whole(model)
    squares, shapes = eigh(K, M)
    own, phi = np.sqrt(squares), B @ shapes
    found = []
    for omega in 2 * np.pi * FREQUENCIES:
        H = (phi / (squares - omega**2 + 2j * 0.002 * own * omega)) @ phi.T
        found.append(np.linalg.solve(np.eye(3) + H @ stuck_springs(), H @ [1.0, 0.5, 0.01]))
    return np.array(found)


def response_error(model, blade, away=0.05):
    """The largest error at frequencies so far from stuck ones, over the largest of the three components there."""
    stuck, wanted = stuck_of_model(model), response_of_model(model)
    found = np.array([response_of_blade(blade, f) for f in FREQUENCIES])
    scale = np.array([1, 1, L_OA])
    errors = np.abs((found - wanted) * scale).max(axis=1) / np.abs(wanted * scale).max(axis=1)
    beside = np.array([np.min(np.abs(stuck / f - 1)) for f in FREQUENCIES])
    return np.max(errors[beside > away])


def test_modes_are_those_of_the_matrices(model):
    K, M, B = whole(model)
    squares, shapes = eigh(K, M)
    blade = reduce(model, n_modes=6)
    assert_allclose(blade.f[:6], np.sqrt(squares[:6]) / (2 * np.pi), rtol=1e-6)  # of SciPy's
    assert_allclose(np.abs(blade.phi[:, :6]), np.abs(B @ shapes[:, :6]), rtol=1e-6, atol=1e-6)
    assert np.max(blade.misfit[:3]) < 0.02
    assert blade.kind == ("mode",) * 6 + ("residual",) * 3


@pytest.mark.parametrize("limit", [None, np.inf, 1500.0])
def test_statics_at_the_shroud_are_exact(model, limit):
    K, _, B = whole(model)
    wanted = B @ np.linalg.solve(K, B.T)
    size = np.sqrt(np.outer(np.diag(wanted), np.diag(wanted)))
    blade = reduce(model, n_modes=3, residual_frequency=limit)
    assert np.max(np.abs(flexibility(blade) - wanted) / size) < 1e-10
    if limit == 1500.0:
        assert np.max(blade.f) == pytest.approx(limit)
    # Control: modes alone leave out what is said of them.
    alone = reduce(model, n_modes=3, residuals=False)
    left = 1 - np.diag(flexibility(alone)) / np.diag(wanted)
    assert_allclose(left, alone.left_out, rtol=1e-6, atol=1e-9)
    assert np.max(left) > 1e-3


def test_a_stiffness_of_any_condition_gives_its_flexibility():
    # Cubic elements of a beam, of length 1 with E I = 1, bend exactly as x^2 (3 n - x) / 6 under 1 N at its end.
    n = 800  # the condition is some 5e12
    element = np.array([[12, 6, -12, 6], [6, 4, -6, 2], [-12, -6, 12, -6], [6, 2, -6, 4]])
    rows = 2 * np.arange(n)[:, None, None] + np.arange(4)[:, None] + 0 * np.arange(4)
    places = rows.ravel(), rows.swapaxes(1, 2).ravel()
    K = csc_array(coo_array((np.tile(element.ravel(), n), places)))[2:, 2:]
    force = np.zeros(2 * n)
    force[-2] = 1
    factor = stiffness_factor(symmetric(K, "K"), np.zeros((2 * n, 6)))
    x = np.arange(1, n + 1)
    bent = x**2 * (3 * n - x) / 6
    assert_allclose(factor.solve(force)[::2], bent, rtol=1e-11)
    # Control: without the refinement rounding is felt.
    rough = factor.root @ factor.solved(factor.root @ force)
    assert np.max(np.abs(rough[::2] / bent - 1)) > 1e-8


def test_stuck_frequencies_and_the_response_need_residual_vectors(model):
    wanted = stuck_of_model(model)[:3]
    blade = reduce(model, n_modes=3)
    assert_allclose(stuck_of_blade(blade)[:3], wanted, rtol=1e-3)
    # Five percent beside a resonance an error of 5e-4 in its frequency is one of 1e-2 in the response.
    assert response_error(model, blade) < 2e-2
    assert response_error(model, reduce(model, n_modes=4)) < 5e-3
    assert response_error(model, reduce(model, n_modes=6)) < 1e-4
    # Controls: modes alone, and theta of the other hand.
    alone = reduce(model, n_modes=3, residuals=False)
    assert np.max(np.abs(stuck_of_blade(alone)[:3] / wanted - 1)) > 0.01
    assert response_error(model, alone) > 0.05
    mirrored = dataclasses.replace(blade, phi=blade.phi * np.array([[1], [1], [-1]]))
    assert response_error(model, mirrored) > 0.05
    assert np.max(np.abs(stuck_of_blade(mirrored)[:3] / wanted - 1)) > 5e-3


@pytest.mark.full
def test_the_response_of_solid_elements():
    # Its block is off its axis, so that all three modes move theta.
    solid = solid_blade(offset=0.005, elements=5)
    error = partial(response_error, solid)
    given = {"nodes": solid.nodes, "shroud": solid.tips, "fixed": solid.root}
    blade = reduce(solid, **given, n_modes=3)
    assert_allclose(stuck_of_blade(blade)[:3], stuck_of_model(solid)[:3], rtol=2e-3)
    assert error(blade, 0.15) < 1e-2  # as the second of these is 1.5e-3 off
    assert error(blade, 0.05) < 4e-2
    assert error(reduce(solid, **given, n_modes=6), 0.05) < 1e-4
    # Controls: modes alone, and theta of the other hand.
    assert error(reduce(solid, **given, n_modes=3, residuals=False), 0.15) > 5e-2
    mirrored = dataclasses.replace(blade, phi=blade.phi * np.array([[1], [1], [-1]]))
    assert error(mirrored, 0.15) > 5e-2


def test_units_and_frames(model):
    # N, mm, s, tonnes; and a frame whose x is along y of the model.
    turn = np.array([int(label.split(".")[1]) > 3 for label in model.labels])
    scale = np.where(turn, 1.0, 1e-3)  # displacements in mm
    blade = reduce(model, n_modes=3)
    in_mm = np.outer(scale, scale) * 1e3
    nodes = {node: 1e3 * place for node, place in model.nodes.items()}
    other = reduce(model, K=model.K * in_mm, M=model.M * in_mm, nodes=nodes, n_modes=3, units="mm-t-s")
    assert_allclose(other.f, blade.f, rtol=1e-6)
    assert_allclose(flexibility(other), flexibility(blade), rtol=1e-7, atol=1e-15)
    assert any("units" in note for note in reduce(model, n_modes=3, units="mm-t-s").notes)
    assert not any("units" in note for note in (*blade.notes, *other.notes))
    turned = reduce(model, n_modes=3, x_axis=(0.0, 1.0, 0.0), y_axis=(-1.0, 0.0, 0.0))
    P = np.array([[0, 1, 0], [-1, 0, 0], [0, 0, 1]])
    assert_allclose(flexibility(turned), P @ flexibility(blade) @ P.T, rtol=1e-8, atol=1e-15)


def test_a_singular_mass_and_one_triangle_are_allowed(model):
    M = model.M.copy()
    turns = [i for i, label in enumerate(model.labels) if label.endswith((".4", ".5", ".6")) and label[:2] != "10"]
    M[np.ix_(turns, range(len(M)))] = 0.0
    M[np.ix_(range(len(M)), turns)] = 0.0
    free = model.free
    K = model.K[np.ix_(free, free)]
    inverse = eigh(M[np.ix_(free, free)], K, eigvals_only=True)
    blade = reduce(model, K=csc_array(np.triu(model.K)), M=csc_array(np.tril(M)), n_modes=2)
    assert_allclose(blade.f[:2], inverse[::-1][:2] ** -0.5 / (2 * np.pi), rtol=1e-9)


def test_damping_is_that_of_its_matrix(model):
    blade = reduce(model, n_modes=3, C=2e-6 * model.K, residual_frequency=np.inf)
    assert_allclose(blade.zeta[:3], 1e-6 * 2 * np.pi * blade.f[:3], rtol=1e-9)
    with pytest.raises(js.InputError, match="damped above critical"):
        reduce(model, n_modes=3, C=1.0 * model.K)


def test_residual_vectors_that_are_stiff_beside_contact_are_left_out(model):
    assert reduce(model, n_modes=3, contact_stiffness=1e3).kind.count("residual") < 3
    assert reduce(model, n_modes=3, contact_stiffness=1e9).kind.count("residual") == 3


WRONG = {
    "asymmetric": ({"C": np.triu(np.ones((90, 90)), -3)}, "C is not symmetric"),
    "free": ({"fixed": []}, r"free to move as a whole \(x, y, z, turns about x, turns about y, turns about z\)"),
    "one line": ({"shroud": ["9", "10"], "dofs": "translations"}, "do not determine its theta"),
    "no node": ({"shroud": ["7", "999"]}, "names node 999"),
    "no place": ({"nodes": {"101": [0, 0, 0]}}, "has no coordinates"),
    "fixed": ({"fixed": ["888"]}, "`fixed` names 888"),
    "rows": ({"dofs": ["1.1"]}, "`dofs` names 1 unknowns"),
    "label": ({"dofs": ["1.7"] * 90}, "direction from 1 to 6"),
    "axes": ({"y_axis": (2.0, 0.0, 0.0)}, "two directions"),
    "units": ({"units": "inch"}, "units"),
    "too many": ({"n_modes": 15}, "at most 16"),
    "negative": ({"negative": True}, "not positive definite"),
    "complex": ({"C": 1j * np.eye(90)}, "C must be a square matrix of real numbers, but is complex128"),
    "no matrix": ({"C": 3.0}, "C must be a square matrix"),
    "driven": ({"zeta": -0.1}, "damped above critical, or driven"),
    "soft residuals": ({"residual_frequency": 10.0}, "above that of the highest mode"),
}


@pytest.mark.parametrize("case", WRONG)
def test_wrong_models_get_one_line(model, case):
    changes, words = WRONG[case]
    changes, K, M = dict(changes), model.K, model.M
    if changes.pop("negative", False):
        K = K - np.diag(np.diag(K) * 1e-2)
    if changes.get("dofs") == "translations":
        own = [i for i, label in enumerate(model.labels) if label.endswith((".1", ".2", ".3"))]
        K, M = K[np.ix_(own, own)] + np.diag(np.ones(len(own))), M[np.ix_(own, own)]
        changes["dofs"] = [model.labels[i] for i in own]
    with pytest.raises(js.InputError, match=words) as caught:
        reduce(model, K=K, M=M, **changes)
    assert "\n" not in str(caught.value)


def test_more_unknowns_than_the_memory_takes_are_refused():
    n = 30_000_000
    from jaxshroud.linear.reduction import require_memory

    with pytest.raises(js.InputError, match="30000000 unknowns would take"):
        require_memory(n)


def written(model, folder):
    """The files of a model in every form, by the words that name them."""
    free = model.free
    K, M = (matrix[np.ix_(free, free)] for matrix in (model.K, model.M))
    labels = [model.labels[i] for i in free]
    nodes = np.array([[float(node), *place] for node, place in model.nodes.items()])
    np.savez(folder / "all.npz", K=K, M=M, dofs=np.array(labels), nodes=nodes)
    savemat(folder / "all.mat", {"K": csc_array(K), "M": M, "dofs": np.array(labels, object)[:, None], "nodes": nodes})
    (folder / "rows.dof").write_text("\n".join(labels) + "\n")
    (folder / "nodes.txt").write_text(
        "*NODE\n" + "\n".join(f"{int(n)}, {x}, {y}, {z}" for n, x, y, z in nodes.tolist())
    )
    for name, matrix in (("K", K), ("M", M)):
        mmwrite(folder / f"{name}.txt.mtx", csc_array(matrix), symmetry="symmetric", precision=17)
        (folder / f"{name}.txt.mtx").rename(folder / f"{name}.dat")  # under any suffix
        save_npz(folder / f"{name}.npz", csc_array(matrix))
        i, j = np.nonzero(np.triu(np.ones_like(matrix)))
        lines = (f"{a + 1} {b + 1} {float(matrix[a, b])!r}" for a, b in zip(i, j, strict=True))
        (folder / f"{name}.sti").write_text("\n".join(lines))
    beside = ["--dofs", "rows.dof", "--nodes", "nodes.txt"]
    return {
        "npz": ["all.npz"],
        "mat": ["all.mat"],
        "market": ["K.dat", "--mass", "M.dat", *beside],
        "sparse": ["K.npz", "--mass", "M.npz", *beside],
        "calculix": ["K.sti", "--mass", "M.sti", *beside],
    }


@pytest.mark.parametrize("form", ["npz", "mat", "market", "sparse", "calculix"])
def test_the_command_reads_files(model, tmp_path, monkeypatch, capsys, form):
    monkeypatch.chdir(tmp_path)
    words = ["reduce", *written(model, tmp_path)[form], "--shroud", ",".join(beam_model.TIPS), "--modes", "3"]
    assert commands.main([*words, "--zeta", "0.002", "--out", "blade.csv"]) == 0
    assert "static flexibility" in capsys.readouterr().out
    blade = reduce(model, n_modes=3)
    scene = js.load("table1", ["blades.modes=blade.csv", "contact.k=2e5"]).scene
    assert_allclose(np.stack([mode.f[0] for mode in scene.blades.modes]), blade.f, rtol=1e-8)
    phi = np.array(
        [[getattr(mode, name)[0] for mode in scene.blades.modes] for name in ("phi_x", "phi_y", "phi_theta")]
    )
    assert_allclose(flexibility(dataclasses.replace(blade, phi=phi)), flexibility(blade), rtol=1e-6, atol=1e-18)


NO_MARKET = "*MATRIX TYPE\nSYMMETRIC\n1,1,2,1, 3.0\n"  # as of Abaqus


@pytest.mark.parametrize(
    ("files", "words"),
    [
        ({"K.mtx": NO_MARKET}, "Abaqus"),
        ({"K.mtx": "1 1\n2 2\n"}, "row column value"),
        ({"K.mtx": "%%MatrixMarket matrix nonsense\n"}, "cannot be read as a matrix"),
        ({"K.mtx": "%%MatrixMarket matrix coordinate pattern symmetric\n1 1 1\n1 1\n"}, "a pattern has no values"),
        ({"K.mtx": ""}, "row column value"),
        ({"K.mtx": "1 1 1.0\n1e300 2 1.0\n"}, "row column value"),
        ({"K.mtx": "\x89HDF\r\n"}, "form that is not read"),
        ({}, "cannot be read"),
        ({"K.mtx": "1 1 1.0\n", "rows.dof": "1.9\n"}, "direction from 1 to 6"),
        ({"K.mtx": "1 1 1.0\n", "rows.dof": "1.1\n1.1\n"}, "stands for two rows"),
        ({"K.mtx": "1 1 1.0\n", "rows.dof": "1.1\n", "nodes.txt": "*NODE\n"}, "holds no nodes"),
    ],
)
def test_wrong_files_get_one_line(tmp_path, monkeypatch, capsys, files, words):
    monkeypatch.chdir(tmp_path)
    for name, text in files.items():
        (tmp_path / name).write_bytes(text.encode("latin-1"))
    line = ["reduce", "K.mtx", "--mass", "K.mtx", "--dofs", "rows.dof", "--nodes", "nodes.txt", "--shroud", "1"]
    assert commands.main([*line, "--out", "blade.csv"]) == 2
    last = capsys.readouterr().err.strip().splitlines()[-1]
    assert words in last


def test_the_shipped_blade_is_that_of_the_model(model):
    blade = reduce(model, n_modes=3)
    modes = js.load("fem_blade").scene.blades.modes
    assert_allclose([mode.f[0] for mode in modes], blade.f, rtol=1e-6)


def test_one_more_mode_is_told(model):
    def change(n, **changes):
        (line,) = (note for note in reduce(model, n_modes=n, **changes).notes if "change by" in note)
        return float(line.split()[-2])

    # Residual vectors carry what modes alone lack.
    assert change(6) < 0.1 < 1.0 < change(6, residuals=False)
    # A fifth mode, at 2.6 times the fourth, is no change of those below.
    assert change(4) < 0.001
    blade = reduce(model, n_modes=3)
    shares = zip(["x", "y", "theta"], reduce(model, n_modes=4).left_out, strict=True)
    left = ", ".join(f"{100 * a:.3g} % along {name}" for name, a in shares)
    assert any(left in note for note in blade.notes)


def test_a_stiffness_at_speed_gives_the_growth_of_each_mode(model):
    # Springs to the ground in proportion to the mass: omega^2 grows by B Omega^2, and shapes stay.
    speed, B = 314.0, 1.7
    K = model.K + B * speed**2 * model.M
    blade = reduce(model, n_modes=3, K_at_speed=K, speed=speed)
    assert_allclose(blade.B[:3], B, rtol=1e-4)  # as omega^2 of the third is 1e4 times this
    assert_array_equal(blade.B[3:], 0.0)
    scene = dataclasses.replace(js.load("fem_blade").scene, blades=blade.blades(12))
    assert_allclose(scene.blades.modes[0].B, B, rtol=1e-6)
    # A spring at one corner turns the shapes.
    K = model.K.copy()
    K[model.labels.index("101.1"), model.labels.index("101.1")] += 1e7
    with pytest.raises(js.InputError, match=r"Mode . is like none at speed \(MAC = 0"):
        reduce(model, n_modes=3, K_at_speed=K, speed=speed)
    with pytest.raises(js.InputError, match="needs its `speed`"):
        reduce(model, K_at_speed=K)


def test_frequencies_over_nodal_diameters_give_the_coupling(model, tmp_path, monkeypatch, capsys):
    squares, kappa, h = (2 * np.pi * np.array([100.0, 500.0])) ** 2, np.array([1e4, -2e4]), np.array([0, 2, 5])
    f = np.sqrt(squares + np.outer(4 * np.sin(np.pi * h / 12) ** 2, kappa)) / (2 * np.pi)
    blade = reduce(model, n_modes=2).in_ring(h, f, 12)
    assert_allclose(blade.f[:2], [100.0, 500.0], rtol=1e-12)
    assert_allclose(blade.kappa[:2], kappa, rtol=1e-8)
    assert_array_equal(blade.kappa[2:], 0.0)
    # Through a table into a ring.
    monkeypatch.chdir(tmp_path)
    model.save("blade.npz")
    (tmp_path / "freq.csv").write_text(
        "h,f1,f2\n" + "\n".join(f"{n},{a!r},{b!r}" for n, (a, b) in zip(h, f.tolist(), strict=True))
    )
    line = ["reduce", "blade.npz", "--shroud", ",".join(beam_model.TIPS), "--fixed", "0", "--modes", "2"]
    line += ["--out", "blade.csv", "--cyclic", "freq.csv", "--blades"]
    assert commands.main([*line, "12"]) == 0
    scene = js.load("fem_blade", ["blades.modes=blade.csv"]).scene
    assert_allclose(scene.blades.modes[1].kappa, np.full(12, -2e4), rtol=1e-6)
    assert blade.blades(12).modes[1].kappa.shape == (12,)
    wrong = {"h,f1\n0,100\n": "as many families", "h,f1,f2\n0,1,x\n": "a cell is a number", "h,f1\n": "below its head"}
    for change, words in (wrong | {"h,f1,f2\n0,100,nan\n2,110,500\n": "above 0"}).items():
        (tmp_path / "freq.csv").write_text(change)
        assert commands.main([*line, "12", "--force"]) == 2
        assert words in capsys.readouterr().err


def test_bad_input_gets_one_line_and_status_2(model, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    model.save("blade.npz")
    assert commands.main(["reduce", "blade.npz", "--shroud", "101,999", "--fixed", "0", "--out", "blade.csv"]) == 2
    assert "names node 999" in capsys.readouterr().err.strip().splitlines()[-1]
    assert not (tmp_path / "blade.csv").exists()
