"""Moving pictures of rows: rings rolled up without tearing what touches, marks where contact is."""

import numpy as np
import pytest
import xarray as xr
from test_animation import faces

import jaxshroud as js
from jaxshroud.model.modes import Mode
from jaxshroud.plotting.animation import MILLIMETRES, Animation, save_animation
from jaxshroud.plotting.frames import last_frames, stored_blocks
from jaxshroud.plotting.run_data import run_data
from jaxshroud.scene.keys import Motion

STEPS, OMEGA, BLADES, GAP = 60, 536.0, 4, 1e-4
SCENE = f"[shroud]\nl_oa = 0.05\nl_ab = 0.035\nalpha = 1.0471975511965976\ngap = {GAP}\n"


def stored(closed, x=0.0):
    """A stored run of a row whose blades move by `x` in turn; interface 0 sticks while the gap there is closed."""
    tau = 2 * np.pi * np.arange(2 * STEPS + 1) / STEPS
    wave = x * np.sin(tau[:, None] - 2 * np.pi * np.arange(BLADES) / BLADES)
    interfaces = BLADES if closed else BLADES - 1
    none = np.zeros((len(tau), interfaces))
    mode, N = none.astype(int), none.copy()
    mode[wave[:, 0] > wave[:, 1] + GAP, 0], N[:, 0] = Mode.STICK, 1.0
    motion = {name: (("time", "blade"), wave if name == "x" else 0 * wave) for name in Motion._fields}
    contact = {"mode": mode, "N": N, "v": none + 1e-6, "contact_point": none}
    data = motion | {name: (("time", "interface"), values) for name, values in contact.items()}
    attrs = {"omega": OMEGA, "steps_per_period": STEPS, "every": 1, "scene": SCENE, "title": "", "end_turns": 0.0}
    return xr.Dataset(data, {"time": tau / OMEGA}, attrs | {"status": 0, "gap": GAP, "kind": "trajectory"})


def animation(ds, factor):
    run = run_data(ds, scale=MILLIMETRES)
    assert run is not None
    return Animation(last_frames(run, 1), stored_blocks(ds), factor, "")


def test_a_ring_closes_and_its_gaps_are_to_scale():
    shown = animation(stored(closed=True), 10.0)
    shown.show(0)
    radius = BLADES * (0.05 + 10 * GAP) / (2 * np.pi)
    corners = faces(shown)
    angles = np.unwrap(np.arctan2(corners[..., 0], corners[..., 1]), axis=0)
    # The face a-b of each block and the opposite one of the next are ten gaps apart everywhere: a to d, b to c.
    to_next = np.roll(angles, -1, axis=0) + 2 * np.pi * (np.arange(BLADES) == BLADES - 1)[:, None] - angles[:, :1]
    np.testing.assert_allclose(radius * to_next[:, 3], 10 * GAP, rtol=1e-9)
    distances = np.hypot(*np.moveaxis(corners, -1, 0))
    np.testing.assert_allclose(distances[:, 0] * distances[:, 1], radius**2, rtol=1e-12)  # conformal: exp(+-h / radius)
    other = radius * (angles[:, 2] - angles[:, 1])
    assert not np.allclose(other, 10 * GAP)  # control: a and c are the corners of one block
    assert "gaps × 10" in "".join(text.get_text() for text in shown.figure.axes[0].texts)


@pytest.mark.parametrize("closed", [True, False])
def test_marks_are_where_blocks_touch_and_nothing_leaves_the_frame(closed):
    shown = animation(stored(closed, x=1e-3), 5.0)
    shown.fix_layout()
    (left, right), (low, high) = shown.figure.axes[0].get_xlim(), shown.figure.axes[0].get_ylim()
    marked = []
    for i in range(shown.frames.sizes["time"]):
        shown.show(i)
        points = np.concatenate([np.asarray(path.vertices) for path in shown.shapes.get_paths()])
        assert ((points > [left, low]) & (points < [right, high])).all()
        marked.append(len(shown.marks.get_offsets()))
        assert not shown.arrows.get_visible()  # which are of pairs
    np.testing.assert_array_equal(marked, (shown.frames["mode"] == Mode.STICK).sum("interface"))
    assert 0 < np.mean(marked) < 1


def test_one_of_many_runs_of_a_row_is_a_row():
    one = stored(closed=True, x=1e-3)
    names = {"t": ("time", one["time"].to_numpy()), "status": 0}
    many = xr.concat([one.drop_vars("time").assign(names)] * 2, "lane", data_vars="all")
    for name in ("status", "scene"):
        many.attrs.pop(name)
    with pytest.raises(js.InputError, match="one run of many"):
        js.Trajectory(many).wave  # noqa: B018  computed when it is asked for
    run = js.Trajectory(many).lane(1)
    assert isinstance(run, js.Trajectory)
    assert np.isnan(run.wave_distance)  # there is no scene here, and without it no engine order
    assert "no engine order" in run.wave.words


@pytest.mark.release
@pytest.mark.full
def test_a_stored_row_is_animated_by_the_factor_that_fits(tmp_path):
    ds = stored(closed=True, x=1e-3)
    assert save_animation(ds, tmp_path / "ring.gif", periods=1) == 5.0  # 15 % of 35 mm over a motion of 1 mm
    assert (tmp_path / "ring.gif").stat().st_size > 0
