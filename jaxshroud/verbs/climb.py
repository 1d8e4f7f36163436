"""Climbing: paths from the best designs of a scan, and the best of these sampled closer and closer.

A start's slope is exact while the motion forgets a push in every operating condition. Where it does not (chaos), or
where a limit is exceeded, it is the slope across a neighbourhood of stated width instead. The best designs often lie
where two kinds of motion meet, and no slope leads along such an edge: the best path ends with a few rounds of samples.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxshroud.batch.states import to_vector
from jaxshroud.batch.tangents import Dual, differentiable, direction, onward, resting, run_flow
from jaxshroud.motion.gradient import slopes
from jaxshroud.results.tuned import Judged
from jaxshroud.scene.precision import in_precision
from jaxshroud.verbs.design import Problem, Tick, begun, judge_designs, scenes_of

RATE = 0.03  # Adam's first step, in units of the cube's side
PUSH = 100.0  # growth of a relative change of a parameter in the state, beyond which an exact slope says nothing
REACH = 0.03  # half width of the neighbourhood that a slope is taken across then
POLISH = (0.03, 0.02, 0.01, 0.005, 0.003, 0.002, 0.001)  # widths of the last rounds' samples
SAMPLES = 8  # in each of these rounds, for each key


class Paths(NamedTuple):
    """Designs along each path, in the unit cube, with their scores and whether their slopes were exact."""

    points: np.ndarray
    scores: np.ndarray
    exact: np.ndarray


def climb(problem: Problem, u: np.ndarray, judged: Judged, updates: int, tick: Tick) -> Paths:
    """Paths from all starts `u` (starts, keys): a step that does not gain is taken back, and the next is shorter."""
    import optax

    adam = optax.adam(1.0)
    memory = adam.init(jnp.asarray(u))
    rate, score = np.full((len(u), 1), RATE), judged.score
    slope, sound = _slope(problem, u, judged, tick)
    points, scores, exact = [u], [score], [sound]
    for _ in range(updates):
        with jax.numpy_dtype_promotion("standard"):  # as optax assumes
            change, memory = adam.update(jnp.asarray(-slope), memory)
        tried = np.clip(u + rate * np.asarray(change), 0.0, 1.0)
        judged = judge_designs(problem, problem.values(tried), tick)
        gains = np.flatnonzero(judged.score > score)
        rate = np.where(judged.score > score, 1.2 * rate.T, rate.T / 3).T
        if len(gains):
            u, score, slope, sound = u.copy(), score.copy(), slope.copy(), sound.copy()
            u[gains], score[gains] = tried[gains], judged.score[gains]
            slope[gains], sound[gains] = _slope(problem, u[gains], Judged(*(a[gains] for a in judged)), tick)
        points.append(u)
        scores.append(score)
        exact.append(sound)
    return Paths(np.array(points), np.array(scores), np.array(exact))


def polished(problem: Problem, u: np.ndarray, score: float, random: np.random.Generator, tick: Tick) -> np.ndarray:
    """The best point of the cube found by sampling closer and closer around `u`."""
    for width in POLISH:
        tried = np.clip(u + width * random.standard_normal((SAMPLES * len(u), len(u))), 0.0, 1.0)
        found = judge_designs(problem, problem.values(tried), tick).score
        if found.max() > score:
            u, score = tried[found.argmax()], float(found.max())
    return u


def _slope(problem: Problem, u: np.ndarray, judged: Judged, tick: Tick) -> tuple[np.ndarray, np.ndarray]:
    """Slopes of the score at points `u` (n, keys) of the cube, and where they are exact."""
    by_run, growth = exact_slopes(problem, u, tick)
    slope = by_run.mean(axis=1) if problem.goal == "mean" else by_run[np.arange(len(u)), judged.P_d.argmin(axis=1)]
    sound = (growth <= PUSH).all(axis=(1, 2)) & (judged.score == judged.objective) & np.isfinite(slope).all(axis=1)
    rough = np.flatnonzero(~sound)
    if len(rough):
        slope[rough] = _wide_slopes(problem, u[rough], tick)
    return np.where(np.isfinite(slope), slope, 0.0), sound


def exact_slopes(problem: Problem, u: np.ndarray, tick: Tick) -> tuple[np.ndarray, np.ndarray]:
    """Derivatives of P_d and growth of a push in the state, both (n, runs, keys), per side of the cube."""
    plan, keys, rows = problem.plan, list(problem.over), problem.runs
    designs, rates = problem.values(u), problem.rates(u)
    scenes = in_precision(scenes_of(problem, designs), problem.plan.method.precision)
    lanes = len(u) * rows * len(keys)
    each = lambda tree: jax.tree.map(lambda a: np.repeat(np.asarray(a), len(keys), axis=0), tree)  # noqa: E731
    unit = [direction(jax.tree.map(lambda a: a[0], scenes), key) for key in keys]
    rate = (np.repeat(rates, rows, axis=0) * np.tile(problem.stretch, (len(u), 1))).ravel()
    along = jax.tree.map(lambda *a: np.tile(np.stack(a), (len(u) * rows, *[1] * np.ndim(a[0]))), *unit)
    along = jax.tree.map(lambda a: (a * rate.reshape(-1, *[1] * (a.ndim - 1))).astype(a.dtype), along)
    scene, state = Dual(each(scenes), along), resting(each(begun(problem, scenes)))
    method, steps = differentiable(plan.method), plan.steps_per_period
    if plan.transient:
        state = onward(run_flow(scene, state, plan.transient, steps, method))
    end = run_flow(scene, state, plan.kept, steps, method)
    tick(lanes * (plan.transient + plan.kept))
    value, tangent = end
    power, by = np.stack(value.power, axis=-1), np.stack(tangent.power, axis=-1)
    slope = np.asarray(slopes(scene.value, power, along, by, "P_d"), float)
    growth = np.abs(to_vector(tangent.state)).max(axis=1) / np.abs(to_vector(value.state)).max(axis=1)
    shape = len(u), rows, len(keys)
    return slope.reshape(shape), np.where(np.isfinite(growth), growth, np.inf).reshape(shape)


def _wide_slopes(problem: Problem, u: np.ndarray, tick: Tick) -> np.ndarray:
    """Slopes of the score across the neighbourhood, one key at a time; one-sided at the cube's faces."""
    n, size = u.shape
    low, high = (np.repeat(u, size, axis=0).reshape(n, size, size) for _ in range(2))
    for i in range(size):
        low[:, i, i] = np.maximum(u[:, i] - REACH, 0.0)
        high[:, i, i] = np.minimum(u[:, i] + REACH, 1.0)
    both = np.concatenate([low, high]).reshape(-1, size)
    score = judge_designs(problem, problem.values(both), tick).score.reshape(2, n, size)
    with np.errstate(invalid="ignore"):  # where a design stops
        return (score[1] - score[0]) / np.einsum("nii->ni", high - low)
