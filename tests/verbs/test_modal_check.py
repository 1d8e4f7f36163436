"""The data sheet of blades by modes: natural modes in each state of contact and over the speed; mistuned rows."""

import dataclasses

import modal_reference
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.linalg import eigh, null_space

import jaxshroud as js
from jaxshroud.linear.natural_modes import linear_contact

HEAVY = "blades.I=2.46e-3"
SCENES = {
    "pair": ("table1", []),
    "ring": ("row_ring12", ["row.blades=4", "row.mistuning=[0.01, 0, -0.01, 0.02]", HEAVY, "drive.engine_order=1"]),
    "points": ("table1_points", [HEAVY]),
    "coupled": ("row_ring12", ["row.blades=3", "row.coupling.k_x=2e4", "row.coupling.k_T=50", HEAVY]),
}


def both(name):
    """A scene of lumped blades and the same by modes."""
    scene = js.load(*SCENES[name]).scene
    return scene, dataclasses.replace(scene, blades=modal_reference.modes_of_lumped(scene.blades).blades)


@pytest.mark.full(but=["pair"])
@pytest.mark.parametrize("name", SCENES)
def test_the_sheet_is_that_of_the_lumped_blades(name):
    sheet, other = map(js.check, both(name))
    for mode, own in zip(sheet.modes, other.modes, strict=True):
        assert (mode.contact, mode.motion, mode.blades) == (own.contact, own.motion, own.blades)
        wanted = (mode.frequency, mode.zeta, mode.driven, *mode.energy)
        assert_allclose((own.frequency, own.zeta, own.driven, *own.energy), wanted, rtol=1e-9, atol=1e-9)
    for coordinate, own in zip(sheet.coordinates.values(), other.coordinates.values(), strict=True):
        assert_allclose([*vars(own).values()], [*vars(coordinate).values()], rtol=1e-9)
    assert other.steps == sheet.steps
    causes = [[doubt.partition(";")[0] for doubt in one.doubts] for one in (sheet, other)]  # cures are of either kind
    assert causes[0] == causes[1]


SHAPES = np.array([[3.5, 0.3, 0.1, 4.0], [-0.3, 3.5, 0.1, 0.6], [7.0, -3.5, 20.0, 17.0]])
F = np.array([170.0, 450.0, 980.0, 1600.0])


def pair(*numbers):
    scene = js.load("table1", ["contact.k=2e5", *numbers]).scene
    return dataclasses.replace(scene, blades=js.modal_blades(F, 0.01, SHAPES))


@pytest.mark.parametrize("contact", ["apart", "sliding", "stuck", "corner"])
def test_frequencies_in_contact_are_those_of_assembled_modes(contact):
    # Faces on each other turn both blades by one angle, by a null space of SciPy.
    scene = pair()
    blades, k, k_d = linear_contact(scene), 2e5, float(scene.friction.k_d)
    alpha, l_oa, l_ab = (float(getattr(scene.shroud, name)) for name in ("alpha", "l_oa", "l_ab"))
    s, c = np.sin(alpha), np.cos(alpha)
    corner = l_oa / 2 + l_ab * c / 2, l_ab * s / 2
    K = np.diag(np.tile((2 * np.pi * F) ** 2, 2))
    other = corner[0] - l_oa, corner[1]  # the lever of the right block
    for stiffness, (x, y) in ((k, (s, -c)), (k_d, (c, s))):
        rows = [np.array([x, y, lever[1] * x - lever[0] * y]) for lever in (corner, other)]
        along = np.concatenate([rows[0] @ SHAPES, -rows[1] @ SHAPES])
        if contact != "apart" and not (contact == "sliding" and stiffness == k_d):
            K += stiffness * np.outer(along, along)
    Z = np.eye(8)
    if contact in ("sliding", "stuck"):
        Z = null_space(np.concatenate([SHAPES[2], -SHAPES[2]])[None])
    wanted = np.sqrt(eigh(Z.T @ K @ Z, eigvals_only=True)) / (2 * np.pi)
    found = [mode.frequency for mode in js.check(scene).modes if mode.contact == contact]
    if contact == "apart":  # alike blades are told once
        wanted = np.unique(np.round(wanted, 6))
    assert_allclose(sorted(found), wanted, rtol=1e-7)
    assert len(blades.moves) == 8


@pytest.mark.full
def test_modes_over_the_speed_grow_as_they_say():
    scene = js.load("table1", ["contact.k=2e5", "drive.engine_order=4", "drive.speed=1300 rpm"]).scene
    B = np.array([1.5, 0.8, 0.2, 0.0])
    scene = dataclasses.replace(scene, blades=js.modal_blades(F, 0.01, SHAPES, B=B))
    lines = js.check(scene).over_speed
    square = np.asarray(lines.speeds) ** 2
    apart = [f for mode, f in zip(js.check(scene).modes, lines.frequencies, strict=True) if mode.contact == "apart"]
    wanted = np.sqrt((2 * np.pi * F[:, None]) ** 2 + B[:, None] * square) / (2 * np.pi)
    assert_allclose(np.sort(apart, axis=0), np.sort(wanted, axis=0), rtol=1e-9)


@pytest.mark.full
def test_patterns_of_mistuning_have_a_closed_form():
    scene, by_modes = both("coupled")
    settings = {"linear": "stuck", "n_patterns": 3, "sigmas": [0.02], "seed": 1}
    frequencies = {"drive.omega": [1000.0, 1100.0]}
    plain = [dataclasses.replace(one, parts=js.Parts(motion=("x", "y"))) for one in (scene, by_modes)]
    found = [js.mistune(one, frequencies, **settings).amplitude for one in plain]
    assert_allclose(found[1], found[0], rtol=1e-9)
    with pytest.raises(js.InputError, match="by modes whose faces are flat"):
        js.mistune(by_modes, frequencies, **settings)
