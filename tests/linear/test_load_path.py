"""A static start with friction: where loads that are applied slowly, in proportion, leave the blades."""

import jax
import numpy as np
import points_reference
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import jaxshroud as js
from jaxshroud.batch.lanes import initial_states
from jaxshroud.linear.equilibrium import static_equilibria
from jaxshroud.linear.load_path import loaded_equilibria
from jaxshroud.model.modes import Mode

FROM_REST = ["initial.start=static", "initial.friction=from rest"]
UNDRIVEN = ["drive.F_0=0", "drive.M_0=0"]
PLANE, PRESSED = 'parts.motion=["x","y"]', "shroud.gap=-0.4 mm"
PUSH = ["drive.F_x_mean=[5,-5]", "drive.F_y_mean=[300,-500]"]
RING = ["row.blades=3", "drive.engine_order=0", "drive.F_x_mean=[10,-60,20]", "drive.F_y_mean=[300,-400,20]"]
PLANE_SCENES = {
    "slips": ("table1", PLANE, PRESSED, *PUSH),
    "touches and slips": ("table1", PLANE, "drive.F_x_mean=[50,-40]", "drive.F_y_mean=[100,-200]"),
    "sticks": ("table1", PLANE, PRESSED, "drive.F_x_mean=[5,-5]"),
    "ring": ("row_ring12", PLANE, "shroud.gap=-0.05 mm", *RING),
    "ring that opens": ("row_ring12", PLANE, "shroud.gap=0.02 mm", *RING),
}
POINT_SCENES = {
    "two points": ("table1_points", "drive.F_x_mean=[50,-50]", "drive.M_mean=[0.3,0.1]"),
    "two pressed": ("table1_points", PRESSED, *PUSH, "drive.M_mean=[3,1]"),
    "three pressed": ("table1_points", PRESSED, "contact.points=3", *PUSH, "drive.M_mean=[30,1]"),
    "ring of points": ("row_ring12", "contact.points=2", "shroud.gap=-0.1 mm", *RING, "drive.M_mean=[0.1,2,-3]"),
}
CORNER_SCENES = {
    "corner": ("table1", PRESSED, "drive.F_y_mean=[-300,500]", "drive.M_mean=[3,-1]"),
    "flat": ("table1", "drive.F_x_mean=[50,-40]", "drive.F_y_mean=[100,-200]", "drive.M_mean=[0.6,0.4]"),
}
SCENES = {**PLANE_SCENES, **POINT_SCENES, **CORNER_SCENES}


def loaded(name, *settings):
    return js.load(name, [*settings, *FROM_REST, *UNDRIVEN]).scene


def lanes_of(*scenes):
    return jax.tree.map(lambda *a: np.stack([np.asarray(one) for one in a]), *scenes)


def led(scene):
    return loaded_equilibria(lanes_of(scene))


class SmallSteps:
    """Equilibria under loads in small steps, by a return of the friction force to its limit at the end of each."""

    def __init__(self, scene):
        self.row = points_reference.row_of(scene)
        self.moves = np.repeat([name in scene.parts.motion for name in ("x", "y", "theta")], scene.layout.blades)
        self.load = points_reference.mean_loads(scene) * self.moves.reshape(3, -1)

    def faces(self, q):
        return points_reference.faces(self.row, np.concatenate([q, 0 * q]))

    def friction(self, at, slider):
        row = self.row
        N = row.k_n[:, None] * row.shares * np.maximum(at.v, 0.0)
        limit = row.mu[:, None] * N
        trial = row.k_d[:, None] * row.shares * (at.u - slider)
        mode = np.where(at.v <= 0, 0, np.where(np.abs(trial) < limit, 1, np.where(trial > 0, 2, 3)))
        return N, np.clip(trial, -limit, limit), mode

    def unbalanced(self, q, share, slider):
        at, (left, right) = self.faces(q), points_reference.sides(self.row)
        N, F, _ = self.friction(at, at.u if slider is None else slider)
        push, total = -N * at.normal - F * at.tangent, share * self.load - self.row.k * q
        for blades, sign, lever in ((left, 1.0, at.lever[0]), (right, -1.0, at.lever[1])):
            moment = lever[1] * push[0] - lever[0] * push[1]
            for i, load in enumerate((push[0], push[1], moment)):
                np.add.at(total[i], blades, sign * load.sum(axis=-1))
        return total.ravel()[self.moves]

    def equilibrium(self, q, share, slider):
        """By Newton's method with differences, whose error makes it converge linearly."""
        flat = q.ravel().copy()
        for _ in range(20):
            r, slopes = self.unbalanced(flat.reshape(q.shape), share, slider), []
            for i in np.flatnonzero(self.moves):
                shift = np.zeros(flat.size)
                shift[i] = 1e-9
                ends = [self.unbalanced((flat + s * shift).reshape(q.shape), share, slider) for s in (1, -1)]
                slopes.append((ends[0] - ends[1]) / 2e-9)
            step = np.linalg.solve(np.array(slopes).T, r)
            flat[self.moves] -= step
            if np.abs(step).max() < 1e-12 * max(np.abs(flat).max(), 1e-9):  # the next one is 1e-7 of it
                break
        return flat.reshape(q.shape)

    def end(self, steps):
        """The position under all loads; a step in which a point changes its state is halved to nothing."""
        q = self.equilibrium(np.zeros(self.load.shape), 0.0, None)
        at, share, step = self.faces(q), 0.0, 1 / steps
        slider, touched = at.u, at.v > 0
        mode = np.where(touched, 1, 0)
        while share < 1:
            step = min(step, 1 - share)
            new = self.equilibrium(q, share + step, slider)
            there = self.faces(new)
            _, F, now = self.friction(there, slider)
            if np.any(now != mode) and step > 1e-13:
                step /= 2
                continue
            share, q, mode, step = share + step, new, now, min(4 * step, 1 / steps)
            stretch = F / (self.row.k_d[:, None] * self.row.shares)
            slider = there.u - np.where(now > 0, stretch, 0.0)
        return q, mode


@pytest.mark.full(but=["slips"])
@pytest.mark.parametrize("scene", {**PLANE_SCENES, **POINT_SCENES}.values(), ids={**PLANE_SCENES, **POINT_SCENES})
def test_it_is_where_small_steps_of_the_loads_lead(scene):
    found = led(loaded(*scene))
    # Where blocks turn, a slider that follows within a step leaves an error of second order at most.
    q, mode = SmallSteps(loaded(*scene)).end(steps=20)
    moved = np.abs(q).max(axis=1, keepdims=True)
    assert np.abs(found.q[0] - q).max() < 1e-9 * moved.max()
    assert_array_equal(found.contact.mode[0], mode)
    assert found.residual < 1e-12


@pytest.mark.full(but=["slips"])
@pytest.mark.parametrize("scene", SCENES.values(), ids=SCENES)
def test_undriven_blades_stay(scene):
    begun = loaded(*scene)
    run = js.simulate(begun, n_periods=50, method=js.RungeKutta("dopri8", steps=300), every=150)
    x, y, theta = run.motion.x, run.motion.y, run.motion.theta
    for part in (x, y, theta):
        assert np.abs(part - part[0]).max() <= 1e-12 * np.abs(part[0]).max()
    assert led(begun).residual < 1e-12
    # The control: the static equilibrium without friction is elsewhere.
    without = static_equilibria(lanes_of(begun))
    assert np.abs(without.q - led(begun).q).max() > 1e-4 * np.abs(without.q).max()


def ramped(name, *settings):
    """The scene of a ramp of the mean loads: a sine of which a quarter of a period lasts 1,000 periods of the scene."""
    scene = loaded(name, *settings)
    F_x, F_y, M = points_reference.mean_loads(scene)
    drive = {"F_0": np.hypot(F_x, F_y), "beta": np.arctan2(F_y, F_x), "M_0": M, "phase": 0 * M}
    kept = [one for one in settings if "_mean" not in one and "engine_order" not in one]
    kept += [f"drive.{key}={value.tolist()}" for key, value in drive.items()]
    kept += [f"drive.omega={float(scene.drive.omega) / 4000}", "initial.start=static"]
    return js.load(name, [*kept, "blades.c_x=40", "blades.c_y=400", "blades.c_T=0.3"]).scene


@pytest.mark.full
@pytest.mark.parametrize("name", ["slips", "two pressed", "ring of points", "corner", "flat"])
def test_it_is_the_end_of_a_slow_ramp(name):
    # The blades lag behind the loads by their damping, which is less the slower these are, and nothing at the end.
    steps = 640_000
    end = js.simulate(ramped(*SCENES[name]), n_periods=1, method=js.RungeKutta("tsit5", steps=steps), every=steps // 4)
    found = led(loaded(*SCENES[name])).q[0]
    for own, part in zip(found, (end.motion.x, end.motion.y, end.motion.theta), strict=True):
        assert np.abs(part[1] - own).max() <= 1e-6 * np.abs(own).max()


def start_of(scene):
    return initial_states(lanes_of(scene))


@pytest.mark.full(but=["slips", "two points"])
@pytest.mark.parametrize("name", ["slips", "flat", "two points"])
def test_without_friction_it_is_the_static_equilibrium(name):
    scene = loaded(*SCENES[name], "friction.mu=0")
    without = static_equilibria(lanes_of(scene))
    assert_allclose(led(scene).q, without.q, rtol=0, atol=1e-13 * np.abs(without.q).max())


@pytest.mark.full(but=["slips"])
@pytest.mark.parametrize("name", ["slips", "three pressed", "corner"])
def test_without_loads_it_is_the_static_equilibrium(name):
    settings = [one for one in SCENES[name][1:] if "_mean" not in one]
    scene = loaded(SCENES[name][0], *settings)
    without = static_equilibria(lanes_of(scene))
    assert_allclose(led(scene).q, without.q, rtol=0, atol=1e-14 * np.abs(without.q).max())
    assert_allclose(start_of(scene).u_s.ravel(), without.at.u.ravel(), rtol=1e-13)
    assert (start_of(scene).mode == Mode.STICK).all()


def test_blades_that_never_touch_follow_their_springs():
    scene = loaded("table1", "drive.F_x_mean=[-5,5]")
    assert_allclose(start_of(scene).motion.x[0], [-5e-5, 5e-5], rtol=1e-14)
    assert (start_of(scene).mode == Mode.APART).all()
    free = loaded("table1", 'parts.contact="none"', "drive.F_x_mean=[5,-5]")
    assert_allclose(start_of(free).motion.x[0], [5e-5, -5e-5], rtol=1e-14)


def test_where_blades_slip_they_begin_elsewhere_than_without_friction():
    scene = loaded(*SCENES["slips"])
    without = static_equilibria(lanes_of(scene))
    assert np.abs(led(scene).q - without.q).max() > 0.02 * np.abs(without.q).max()
    state, at = start_of(scene), led(scene).at
    assert (state.mode == Mode.SLIP_PLUS).all()
    # At its limit the friction spring carries mu N.
    force = float(scene.friction.k_d) * (at.u[0, 0, 0] - state.u_s[0])
    assert_allclose(force, float(scene.friction.mu) * at.N[0, 0, 0], rtol=1e-12)


@pytest.mark.full
def test_lanes_are_led_alike_together_and_alone():
    scenes = [loaded(*SCENES["two pressed"], f"friction.mu={mu}") for mu in (0.0, 0.1, 0.3, 0.8)]
    together = loaded_equilibria(lanes_of(*scenes))
    for i, scene in enumerate(scenes):
        assert_allclose(together.q[i], led(scene).q[0], rtol=0, atol=1e-15)
    assert len(np.unique(together.q[:, 0, 0])) == 4
