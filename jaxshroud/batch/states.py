"""The states of lanes: as compiled loops carry them, as users have them, as rows of numbers; and the ways between.

| where | motion | what the model leaves out |
|---|---|---|
| compiled loops | pairs of scalars: flat arrays of lanes are faster than strided ones | absent |
| scenes, results, starts | arrays with a last axis for the blade | 0 |
| linear algebra | a row of 13: x, y, theta and their rates, left blade before right, then the slider | 0 |
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxshroud.model.absent import ABSENT, filled, is_absent
from jaxshroud.model.friction import Springs
from jaxshroud.model.modes import Mode
from jaxshroud.model.ready import Model
from jaxshroud.model.state import State, as_pairs
from jaxshroud.scene.motion import Motion
from jaxshroud.scene.scene import Scene

STATE = 13  # numbers of a state


def inside(state: State, model: Model) -> State:
    """A user's state as compiled loops carry it."""
    names = [name.removeprefix("v_") for name in Motion._fields]
    keep = lambda name, pair: tuple(pair[i] if model.parts.has(name, i) else ABSENT for i in (0, 1))  # noqa: E731
    motion = Motion(*(keep(name, pair) for name, pair in zip(names, as_pairs(state.motion), strict=True)))
    mode = jnp.full_like(state.mode, Mode.SMOOTH) if model.spring.smooth else state.mode
    return State(motion, _slider(state, model.spring), mode, state.case)


def _slider(state: State, spring: Springs) -> Any:
    """The slider, or the state of own laws, which is their first one unless the state has it."""
    laws = spring.laws
    if is_absent(laws):
        return ABSENT if is_absent(spring.lag) else state.u_s
    if laws.friction is None:
        return ABSENT
    fits = jnp.shape(state.u_s) == laws.z.shape
    return jnp.where(state.mode == Mode.APART, laws.z, state.u_s) if fits else laws.z


def whole(state: State) -> State:
    """A state of compiled loops with zeros for what is absent."""
    motion, u_s = filled((state.motion, state.u_s), state.motion.x[0])
    return State(motion, u_s, state.mode, state.case)


def as_arrays(motion: Motion) -> Motion:
    """A motion of pairs with fields of shape (2,), inside compiled functions."""
    return Motion(*map(jnp.stack, motion))


def by_blade(motion: Motion) -> Motion:
    """Motions of pairs (each (...,)) as NumPy arrays (..., 2)."""
    return Motion(*(np.stack(pair, axis=-1) for pair in motion))


def rows(motion: Motion) -> np.ndarray:
    """Motions of pairs (each (...,)) as rows (..., 12)."""
    return np.concatenate(by_blade(motion), axis=-1)


def final_states(state: State) -> State:
    """What compiled loops have come to, as a start for others."""
    state = whole(state)
    return State(by_blade(state.motion), state.u_s, state.mode, state.case)


def as_precise(state: State, scene: Scene) -> State:
    """The state with real numbers of the scene's precision."""
    real = lambda a: np.issubdtype(np.asarray(a).dtype, np.floating)  # noqa: E731
    return jax.tree.map(lambda a: np.asarray(a, scene.drive.omega.dtype if real(a) else None), state)


def to_vector(state: State) -> np.ndarray:
    """States (motions as arrays (..., 2) or as pairs) as rows (..., 13)."""
    pairs = [a if isinstance(a, tuple) else (a[..., 0], a[..., 1]) for a in state.motion]
    return np.stack([np.asarray(a) for pair in pairs for a in pair] + [np.asarray(state.u_s)], axis=-1)


def from_vector(vector: np.ndarray, mode: Any, case: Any) -> State:
    """The inverse of `to_vector`."""
    return State(Motion(*(vector[..., i : i + 2] for i in range(0, 12, 2))), vector[..., 12], mode, case)
