"""A method and quantities of one's own: Heun's method, the mean penetration while faces touch, the path of a blade.

All three are defined here, and march a pair and a row of three blades without a change of the package.
"""

from functools import cache
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxshroud as js
from jaxshroud.batch.lanes import initial_states
from jaxshroud.batch.plan import Plan
from jaxshroud.batch.runs import run_lanes
from jaxshroud.cache.key import UnknownPartError, description
from jaxshroud.march.accumulator import Log
from jaxshroud.march.events import place_contact
from jaxshroud.march.logged import BUILT_IN, observables_of
from jaxshroud.march.method import FAST, Choices
from jaxshroud.march.observable import Beginning, BladeTrial, InterfaceTrial, Observable, from_zero
from jaxshroud.march.tableau import Tableau
from jaxshroud.model.arithmetic import where
from jaxshroud.model.modes import Mode
from jaxshroud.scene.checks import InputError
from jaxshroud.scene.grids import scenes_at

HEUN = Tableau("heun", a=((), (1.0,)), b=(0.5, 0.5), c=(0.0, 1.0), order=2)


class Touch(NamedTuple):
    """The penetration while faces touch."""

    integral: jnp.ndarray  # of the penetration over this time [m s]
    time: jnp.ndarray  # [s]


def no_touch(at: Beginning) -> Touch:
    return Touch(at.zero, at.zero)


def with_touch(before: Touch, trial: InterfaceTrial) -> Touch:
    """By the trapezoidal rule, of second order as Heun's method is."""
    depth = lambda z: place_contact(z, trial.start, trial.model)[2].v
    mean = (depth(trial.start.motion) + depth(trial.end)) / 2
    touches = trial.start.mode != Mode.APART
    return Touch(
        before.integral + where(touches, mean * trial.h, 0.0),
        before.time + where(touches, trial.h, 0.0),
    )


def with_path(before: jnp.ndarray, trial: BladeTrial) -> jnp.ndarray:
    return before + jnp.abs(trial.end.x - trial.start.x)


TOUCH = Observable("touch", "penetration while faces touch", "m s, s", "interface", no_touch, with_touch, from_zero)
PATH = Observable("path", "distance along x", "m", "blade", lambda at: at.zero, with_path, from_zero)
OWN = Choices(HEUN, "cubic", ledger=False, observables=(TOUCH, PATH))
PERIODS, COARSE, STEPS, FINE = 2, 800, 1600, 12800
IN_X, STIFFNESS = 'parts.motion=["x"]', 2.5
LAYOUTS = {
    "pair": ("table1", (IN_X,)),
    "row of three": ("row_ring12", ("row.blades=3", "row.closed=false", "drive.engine_order=1", IN_X)),
}


@pytest.fixture(scope="module", params=LAYOUTS)
def layout(request):
    return request.param


def scene_in(layout):
    name, changes = LAYOUTS[layout]
    return js.vary(js.load(name, list(changes)).scene, "contact.gamma", STIFFNESS)


@cache
def marched(layout, steps, method=OWN):
    """The samples of one lane, with axes (period, blade) or (period, interface)."""
    scenes = scenes_at(scene_in(layout), ["contact.gamma"], np.array([[STIFFNESS]]))
    runs = run_lanes(scenes, initial_states(scenes), Plan(0, PERIODS, steps, 0.0, method), lambda _: None)
    return jax.tree.map(lambda a: a[0], runs.samples)


@cache
def true_run(layout):
    """The states at the ends of many steps by RK4."""
    return js.simulate(scene_in(layout), n_periods=PERIODS, method=js.RungeKutta("rk4", FINE))


def by_period(a):
    """Numbers at the ends of steps as (period, step, blade or interface)."""
    return np.asarray(a)[1:].reshape(PERIODS, FINE, -1)


def error(layout, steps, method=OWN):
    """Of the motion after two periods, in shares of the largest displacement."""
    got, want = (np.asarray(run.motion.x)[-1] for run in (marched(layout, steps, method), true_run(layout)))
    return np.abs(got - want).max() / np.abs(want).max()


@pytest.mark.full(but=["pair"])
def test_the_error_of_heuns_method_falls_with_the_square_of_the_step(layout):
    assert 3.4 < error(layout, COARSE) / error(layout, STEPS) < 4.6
    # Control: a method of fourth order is a hundred times as accurate, and its error falls sixteenfold.
    assert error(layout, STEPS, FAST) < error(layout, STEPS) / 100


@pytest.mark.full(but=["pair"])
def test_the_mean_penetration_while_faces_touch_is_that_of_many_samples(layout):
    run, own = true_run(layout), marched(layout, STEPS).own["touch"]
    v, touches = by_period(run.v), by_period(run.mode) != Mode.APART
    want = np.sum(v * touches, axis=1) / np.sum(touches, axis=1)
    # The error of Heun's method, up to 2e-4; samples know an onset to a step, some 1e-4 of the contact.
    np.testing.assert_allclose(own.integral / own.time, want, rtol=1e-3)
    # Control: the mean over the whole period, in more than half of which the faces are apart.
    assert np.all(own.integral / scene_in(layout).drive.period < want / 2)


@pytest.mark.full(but=["pair"])
def test_the_path_of_each_blade_is_that_of_many_samples(layout):
    x = np.asarray(true_run(layout).motion.x)
    want = np.sum(np.abs(by_period(x) - np.asarray(x)[:-1].reshape(PERIODS, FINE, -1)), axis=1)
    np.testing.assert_allclose(marched(layout, STEPS).own["path"], want, rtol=1e-3)
    # Control: twice the range of x, which is the path where a blade moves to and fro once in a period.
    once = 2 * np.ptp(x.reshape(len(x), -1)[-FINE:], axis=0)
    assert np.any(np.abs(once / want[-1] - 1) > 0.01)


def test_a_program_with_functions_of_a_user_is_not_kept():
    description(OWN._replace(observables=()))  # control
    with pytest.raises(UnknownPartError):
        description(OWN)


@pytest.mark.parametrize("name", ["touch", "v_max"])
def test_every_observable_has_a_name_of_its_own(name):
    with pytest.raises(InputError, match=name):
        observables_of(OWN._replace(observables=(TOUCH, PATH._replace(name=name))))


def test_the_log_has_the_built_in_observables_in_their_order():
    assert (*(one.name for one in BUILT_IN), "own") == Log._fields
