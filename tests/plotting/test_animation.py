"""Moving pictures: blocks to scale, motion exaggerated by a stated factor, forces where they act."""

import shutil

import numpy as np
import pytest
from numpy.testing import assert_allclose
from PIL import Image
from test_plot_contact import HALF, run

from jaxshroud.plotting.animation import POINTS_ON_EDGE, Animation, save_animation
from jaxshroud.plotting.frames import last_frames, stored_blocks
from jaxshroud.plotting.run_data import run_data
from jaxshroud.plotting.style import COLUMN_WIDTH
from jaxshroud.scene.checks import InputError

SHAPE = "[shroud]\nl_oa = 0.05\nl_ab = 0.035\nalpha = 1.0471975511965976\n"


def still(n_periods=3):
    """A run whose blocks move but do not turn, in contact at the upper corner."""
    ds = run(n_periods, scene=SHAPE)
    ds["theta"] = 0 * ds["theta"]
    ds["contact_point"] = ds["contact_point"] * 0 + HALF
    return ds


def animation(ds, factor):
    at = run_data(ds)
    return Animation(last_frames(at, 1), stored_blocks(ds), factor, "")


def faces(shown):
    """The corners of each block as drawn: a, b and their opposites, (N, 4, 2)."""
    return np.stack([np.asarray(path.vertices)[:-1:POINTS_ON_EDGE] for path in shown.shapes.get_paths()])


def test_blocks_have_their_shape_and_move_by_the_factor():
    ds = still()
    shown = animation(ds, 10.0)
    shown.show(15)  # a quarter of the period: x_1 = 1 mm, x_2 = -1 mm
    left, right = faces(shown)
    sides = np.linalg.norm(np.diff(left, axis=0, append=left[:1]), axis=1)
    assert_allclose(sides, [0.035, 0.05, 0.035, 0.05], rtol=1e-12)
    assert_allclose(left.mean(axis=0)[0], 10 * 1e-3, rtol=1e-3)
    # Centres are a block and ten gaps apart, less ten times the approach.
    assert_allclose((right - left).mean(axis=0)[0], 0.05 + 10 * 2e-5 - 10 * 2e-3, rtol=1e-3)
    assert "motion and gap × 10" in [text.get_text() for text in shown.figure.axes[0].texts]


def test_forces_act_at_the_contact_point_and_are_opposite():
    shown = animation(still(), 1.0)
    shown.show(15)
    corner = faces(shown)[0, 0]  # a: the upper one of the contact face
    assert_allclose(shown.arrows.get_offsets(), np.tile(corner, (4, 1)), atol=1e-12)
    U, V = shown.arrows.U, shown.arrows.V
    assert_allclose([U[0] + U[1], V[0] + V[1], U[2] + U[3], V[2] + V[3]], 0, atol=1e-15)
    # The normal force pushes the left block to the left, at right angles to the face; mu N = N / 2 along it.
    assert_allclose([U[0], V[0]] @ (corner - faces(shown)[0, 1]), 0, atol=1e-15)
    assert U[0] < 0
    assert_allclose(np.hypot(U[2], V[2]) / np.hypot(U[0], V[0]), 0.5, rtol=1e-12)
    shown.show(45)
    assert not shown.arrows.get_visible()
    assert "apart" in shown.caption.get_text()


@pytest.mark.release  # docs/verbs/animate.md animates a run
@pytest.mark.full
def test_a_gif_has_sixty_frames_of_a_period(tmp_path):
    path = tmp_path / "run.gif"
    factor = save_animation(still(), path, periods=1, dpi=50)
    assert factor == 5.0  # 15 % of 35 mm over a motion of 1 mm
    with Image.open(path) as image:
        assert image.n_frames == 60
        assert image.width == int(COLUMN_WIDTH * 50)
    assert [found.name for found in tmp_path.iterdir()] == ["run.gif"]


def test_what_cannot_be_made_is_told(tmp_path, monkeypatch):
    monkeypatch.setattr(shutil, "which", lambda name: None)
    for name, ds, message in (
        ("run.mp4", still(), "needs ffmpeg.*gif"),
        ("run.avi", still(), "ends in .gif or .mp4"),
        ("run.gif", run(3, every=25), "too few to show"),
        ("run.gif", run(3, scene=""), "does not hold the shape"),
    ):
        with pytest.raises(InputError, match=message):
            save_animation(ds, tmp_path / name)
