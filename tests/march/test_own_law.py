"""A law of contact of one's own: a normal spring that stiffens with the cube of the penetration, with friction.

It is defined here, and marches a pair and a row of three blades without a change of the package.
"""

from functools import cache

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxshroud as js
from jaxshroud.batch.lanes import initial_states
from jaxshroud.batch.periods import Sample
from jaxshroud.batch.plan import Plan
from jaxshroud.batch.runs import run_lanes
from jaxshroud.march.method import Choices
from jaxshroud.march.tableau import tableau
from jaxshroud.model.arithmetic import ZERO, Scalar, where
from jaxshroud.model.contact_law import (
    ContactLaw,
    ContactPoint,
    FrictionGuard,
    GuardCrossing,
    LawForces,
    Modes,
    Slider,
    linear_laws,
)
from jaxshroud.model.modes import Mode, Status
from jaxshroud.model.prepared import law_type, prepared_law
from jaxshroud.model.spring_contact import BilinearContact, after_friction, slip_mode, slip_sign


class CubicContact(ContactLaw):
    """N = k v + k_3 v^3, and a spring k_d in series with a slider that slips at mu N."""

    has_stick = True

    k: Scalar  # [N/m]
    k_3: Scalar  # [N/m^3]
    k_d: Scalar  # [N/m]
    mu: Scalar

    @property
    def normal_stiffness(self):
        return self.k

    @property
    def tangential_stiffness(self):
        return self.k_d

    def pressed(self, v):
        return self.k * v + self.k_3 * v**3

    def slip_stretch(self, v, mode):
        return slip_sign(mode, v.dtype) * self.mu * self.pressed(v) / self.k_d

    def slip_speed(self, at, rate, mode):
        """The rate of the slider in slip, u' less that of the stretch; 0 in other modes."""
        sigma = slip_sign(mode, at.v.dtype)
        return sigma**2 * rate.u - sigma * self.mu * (self.k + 3 * self.k_3 * at.v**2) * rate.v / self.k_d

    def forces(self, point: ContactPoint) -> LawForces:
        N = where(point.mode == Mode.APART, 0.0, self.pressed(point.at.v))
        F = self.k_d * self.stretch(point.at.v, point.at.u, point.u_s, point.mode)
        return LawForces(N, F, ZERO)

    def stretch(self, v: Scalar, u: Scalar, u_s: Slider, mode: Modes) -> Slider:
        return where(mode == Mode.STICK, u - u_s, self.slip_stretch(v, mode))

    def stored_energy(self, v: Scalar, w: Slider, mode: Modes) -> Scalar:
        return where(mode == Mode.APART, 0.0, self.k * v**2 / 2 + self.k_3 * v**4 / 4 + self.k_d * w**2 / 2)

    def dissipated_power(self, point: ContactPoint, forces: LawForces) -> Scalar:
        return forces.F * self.slip_speed(point.at, point.rates(), point.mode)

    def carried_slider(self, u_s: Slider, mode: Modes) -> Slider:
        return u_s

    def friction_guard(self, at, rate, u_s, mode) -> FrictionGuard:
        stick, sigma, w = mode == Mode.STICK, slip_sign(mode, at.v.dtype), at.u - u_s
        limit, grows = self.mu * self.pressed(at.v), self.mu * (self.k + 3 * self.k_3 * at.v**2) * rate.v
        in_slip = where(sigma == 0, -1.0, -sigma * self.slip_speed(at, rate, mode))
        path = -sigma * at.u + sigma * self.slip_stretch(at.v, mode)
        return FrictionGuard(
            where(stick, jnp.abs(w) - limit / self.k_d - 2 * at.rounding, in_slip),
            where(stick, jnp.sign(w) * rate.u - grows / self.k_d, 0.0),
            where(stick, 0.0, path),
        )

    def onset_mode(self, crossing: GuardCrossing) -> Modes:
        rate = crossing.rate
        slips = self.k_d * jnp.abs(rate.u) > self.mu * self.k * rate.v  # where v = 0
        return where(slips, slip_mode(rate.u < 0), jnp.int32(Mode.STICK))

    def mode_after_rub(self, crossing: GuardCrossing) -> Modes:
        return after_friction(crossing)

    def slider_after(self, crossing: GuardCrossing, w: Slider, mode: Modes, u: Scalar) -> Slider:
        return where(crossing.mode == Mode.APART, crossing.at.u, u - w)


class WithoutCubicEnergy(CubicContact):
    """Control: it forgets what the cubic term stores."""

    def stored_energy(self, v: Scalar, w: Slider, mode: Modes) -> Scalar:
        return where(mode == Mode.APART, 0.0, self.k * v**2 / 2 + self.k_d * w**2 / 2)


PERIODS, STEPS = 2, 800
METHOD = Choices(tableau("dopri8"), "bisection")
STIFFENING = 1e8  # k_3 / k [1/m^2]: a penetration of 0.1 mm, which is reached, has twice the force of a straight spring
SCENES = {
    "pair": ("table1", ()),
    "row of three": ("row_ring12", ("row.blades=3", "row.closed=false", "drive.engine_order=1")),
}


def scene_of(layout: str) -> js.Scene:
    name, changes = SCENES[layout]
    return js.vary(js.load(name, list(changes)).scene, "contact.gamma", 2.5)


def with_law(layout: str, kind: type[CubicContact], stiffening: float) -> js.Scene:
    """The scene with a cubic law whose straight spring and friction are those of the article's law."""
    scene = scene_of(layout)
    k, k_d, mu = (np.ravel(a)[0] for a in (scene.k, scene.friction.k_d, scene.friction.mu))
    return js.with_contact_law(scene, kind(k, stiffening * k, k_d, mu))


@cache
def marched(layout: str, kind: type[ContactLaw] = CubicContact, stiffening: float = STIFFENING) -> Sample:
    """The samples of a lane whose law of contact is one of those above, or the article's."""
    scene = with_law(layout, kind, stiffening) if issubclass(kind, CubicContact) else scene_of(layout)
    scenes = jax.tree.map(lambda a: jnp.asarray(a)[None], scene)
    run = run_lanes(scenes, initial_states(scenes), Plan(0, PERIODS, STEPS, 0.0, METHOD), lambda _: None)
    assert np.all(np.asarray(run.last.status) == Status.OK)
    return run.samples


def imbalance(samples: Sample) -> float:
    """The residual of the energy balance over the gross work, of all periods."""
    return float(np.abs(samples.residual).max() / np.sum(samples.gross, axis=-1).max())


def furthest(a: Sample, b: Sample) -> float:
    """The largest difference of the motion, over the largest displacement."""
    return float(np.abs(a.motion.x - b.motion.x).max() / np.abs(b.motion.x).max())


@pytest.mark.full
@pytest.mark.parametrize("layout", SCENES)
def test_the_energy_of_a_cubic_spring_balances(layout):
    assert imbalance(marched(layout)) < 1e-9
    # Control: without the energy of the cubic term in a contact that lasts at the end of a period or switches its case.
    assert imbalance(marched(layout, WithoutCubicEnergy)) > 1e-6


@pytest.mark.full
@pytest.mark.parametrize("layout", SCENES)
def test_without_the_cubic_term_it_is_the_articles_law(layout):
    article = marched(layout, BilinearContact)
    # Rounding, which every impact multiplies: 1e-9 in the row.
    assert furthest(marched(layout, CubicContact, 0.0), article) < 1e-7
    assert furthest(marched(layout), article) > 1e-3  # control


@pytest.mark.full
@pytest.mark.parametrize("layout", SCENES)
def test_laws_of_functions_are_the_same_law(layout):
    # Without friction; the class locates events by its own guards, the functions by those of any normal law.
    name, changes = SCENES[layout]
    bending = js.load(name, [*changes, 'parts.motion=["x"]', "contact.gamma=2.5"]).scene
    k, k_d, mu = (float(np.ravel(a)[0]) for a in (bending.k, bending.friction.k_d, bending.friction.mu))
    k_3 = STIFFENING * k
    scene = js.with_contact_law(bending, CubicContact(k, k_3, k_d, mu))
    smooth = eqx.tree_at(lambda s: s.laws.mu, scene, jnp.asarray(0.0))
    functions = js.Laws(lambda v, v_t: (k * v + k_3 * v**3, k * v**2 / 2 + k_3 * v**4 / 4))
    method = js.RungeKutta("dopri8", steps=STEPS)
    by_class, own, straight = (
        js.simulate(one, n_periods=1, method=method)
        for one in (smooth, js.with_contact_law(scene, functions), js.with_contact_law(scene, js.Laws(Straight(k))))
    )
    error = lambda run: np.abs(run.motion.x - by_class.motion.x).max() / np.abs(by_class.motion.x).max()
    assert error(own) < 1e-7
    assert error(straight) > 1e-3  # control: without the cubic term


class Straight(eqx.Module):
    """A straight spring as a normal law."""

    k: float

    def __call__(self, v, v_t):
        return self.k * v, self.k * v**2 / 2


@pytest.mark.full
@pytest.mark.parametrize("layout", SCENES)
def test_functions_of_friction_balance(layout):
    # LuGre friction, whose z is integrated at each interface: what it dissipates is counted.
    scene = js.load(*[SCENES[layout][0], [*SCENES[layout][1], 'parts.motion=["x"]']]).scene
    k = float(np.ravel(scene.k)[0])
    laws = js.Laws(Straight(k), js.LuGre(k_d=1e5, c=0.0, mu=0.2, N_0=1.0))
    own = js.with_contact_law(scene, laws)
    js.check_laws(own)
    run = js.simulate(own, n_periods=2, method=js.RungeKutta("dopri8", steps=STEPS))
    assert run.status == Status.OK
    assert np.all(np.asarray(run.data.loss_friction) > 0)
    assert abs(run.energy_residual) < 1e-6


def test_laws_with_arrays_are_refused_in_rows():
    laws = js.Laws(Straight(1e6), lambda z, u_t, N: (0.0 * z[0], 0.0 * z, 0.0 * z[0]), np.zeros(2))
    with pytest.raises(js.InputError, match="must not be arrays in rows"):
        js.with_contact_law(scene_of("row of three"), laws)


def test_a_scene_with_a_law_of_its_own_is_like_any_other():
    scene = with_law("pair", CubicContact, STIFFENING)
    assert law_type(scene) is CubicContact
    found = js.power(scene, n_periods=PERIODS, transient=0, method=js.RungeKutta(steps=STEPS))
    assert found.status == Status.OK
    with pytest.raises(js.InputError, match="not own laws"):
        js.simulate(scene, n_periods=1, method=js.Taylor())
    with pytest.raises(js.InputError, match="not for own laws"):
        js.simulate(scene, n_periods=1, method="balanced")
    with pytest.raises(js.InputError, match=r"js\.with_contact_law"):
        js.check_laws(scene)


def test_power_series_march_no_cubic_spring():
    with pytest.raises(TypeError, match="CubicContact"):
        linear_laws(CubicContact(*(jnp.asarray(1.0) for _ in range(4))))
    assert linear_laws(prepared_law(scene_of("pair")))  # control
