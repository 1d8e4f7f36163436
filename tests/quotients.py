"""Difference quotients that say how well they are known, for the tests of derivatives.

A quotient over a long step sees kinks and curvature, one over a short step rounding. Where the two leave room between
them, quotients of neighbouring steps agree; where they do not, no difference knows the derivative. That is decided
without a look at what is tested.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import jax
import numpy as np

import jaxshroud as js
from jaxshroud.batch.flows import as_differentiable
from jaxshroud.batch.lanes import initial_states
from jaxshroud.batch.tangents import direction, tangents
from jaxshroud.batch.xla import one_lane
from jaxshroud.march.method import choices
from jaxshroud.orbits.batched_algorithms import run_alone
from jaxshroud.orbits.gradient import orbit_gradient
from jaxshroud.results.gradient import Gradient
from jaxshroud.results.orbit import Orbit
from jaxshroud.scene.vary import level_of

STEPS = 10.0 ** -np.arange(3, 8.01, 0.5)  # relative
LEAST = 1e-5  # of value over number: smaller slopes are judged by this size


class Quotients(NamedTuple):
    """Derivatives by differences."""

    slope: np.ndarray  # (lanes, observed, numbers)
    size: np.ndarray  # largest slope (lanes, numbers)
    doubt: np.ndarray  # how far the quotients of two steps differ, over the largest slope (lanes, numbers)

    def error(self, slope: np.ndarray) -> np.ndarray:
        """Largest difference from other slopes over the largest slope, (lanes, numbers)."""
        return np.max(np.abs(slope - self.slope), axis=1) / self.size


def quotients(f: Callable[[jax.Array], jax.Array], numbers: jax.Array) -> Quotients:
    """Fourth-order differences of `f` (lanes, observed) by each of the `numbers` (lanes, n), all of them not zero.

    Of the steps that are tried, each number of each lane has the one that differs least from the next.
    """
    found = np.stack([_by(f, numbers, h) for h in STEPS])
    change = np.max(np.abs(np.diff(found, axis=0)), axis=2)
    best = np.argmin(change, axis=0)[None]
    slope = np.take_along_axis(found, best[:, :, None], axis=0)[0]
    values = np.max(np.abs(np.asarray(f(numbers))), axis=1, keepdims=True)
    size = np.maximum(np.max(np.abs(slope), axis=1), LEAST * values / np.abs(numbers))
    return Quotients(slope, size, np.take_along_axis(change, best, axis=0)[0] / size)


def _by(f: Callable[[jax.Array], jax.Array], numbers: jax.Array, h: float) -> np.ndarray:
    """Quotients at one relative step."""

    def along(i: int) -> np.ndarray:
        ends = [np.asarray(f(numbers.at[:, i].multiply(1 + c * h))) for c in (-2, -1, 1, 2)]
        return (ends[0] - 8 * ends[1] + 8 * ends[2] - ends[3]) / (12 * h * np.asarray(numbers)[:, i : i + 1])

    return np.stack([along(i) for i in range(numbers.shape[1])], axis=-1)


def on_orbit(found: Orbit, wrt: Sequence[str]) -> Gradient:
    """The exact gradient of P_d on the orbit of a single scene."""
    cycle = found.cycle()
    numbers = [[level_of(cycle.scene, key) for key in wrt]]
    return Gradient.of_slopes([run_alone(orbit_gradient(cycle, wrt, "P_d"))], wrt, "P_d", found, numbers)


def assert_tangents_by_keys(scene: js.Scene, keys: Sequence[str], by: js.RungeKutta, relative: float) -> None:
    """The tangents of one period by some numbers are its central differences with such a relative step."""
    method, start = as_differentiable(choices(by)), jax.tree.map(lambda a: a[0], initial_states(one_lane(scene)))
    flow = lambda scene, directions: tangents(scene, start, directions, n=1, steps=by.steps, method=method)
    found = flow(scene, [direction(scene, key) for key in keys])
    vector = slice(0, found.vector.size - scene.sliders)  # sliders of contact that is apart at the end mean nothing
    assert found.status == 0
    for i, key in enumerate(keys):
        value = float(np.ravel(js.value_of(scene, key))[0])
        step = relative * value
        up, down = (flow(js.vary(scene, key, value + s), []) for s in (step, -step))
        for slope, a, b in (
            (found.by_parameter[vector, i], up.vector[vector], down.vector[vector]),
            (found.power_by_parameter[:, i], up.power, down.power),
        ):
            difference = (a - b) / (2 * step)
            np.testing.assert_allclose(slope, difference, rtol=0, atol=2e-5 * np.abs(slope).max(), err_msg=key)
