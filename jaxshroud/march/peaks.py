"""The largest forces of contact, those inside the steps too."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool

from jaxshroud.march.events import seat
from jaxshroud.march.locate import Rise
from jaxshroud.march.within import crest
from jaxshroud.model.absent import ABSENT, Scalar, is_absent
from jaxshroud.model.friction import normal_force, slip_sign
from jaxshroud.model.geometry import touch_rates
from jaxshroud.model.modes import Mode
from jaxshroud.model.ready import Model
from jaxshroud.model.rhs import forces
from jaxshroud.model.state import State
from jaxshroud.scene.motion import Motion


class Peaks(NamedTuple):
    """Largest forces so far [N], on both sides of every event and by cubics inside each trial step.

    The cubic goes through the values and rates of the penetration, and of the friction force, at both ends of a trial:
    what it misses falls as the fourth power of the step. The friction of smooth contact and the forces of own laws are
    seen at ends only.
    """

    N: Scalar
    F: Scalar


class _Seen(NamedTuple):
    """What contact does at one end of a trial step."""

    v: Scalar
    v_rate: Scalar
    N: Scalar
    F: Scalar  # absent without friction, like its rate
    F_rate: Scalar


def peaks(before: Peaks, held: State, z: Motion, h: Scalar, model: Model) -> Peaks:
    """The largest forces after a trial step of `h` seconds from `held` to the motion `z`."""
    a, b = _seen(held.motion, held, model), _seen(z, held, model)
    deepest = _top(Rise(a.v, b.v, a.v_rate * h, b.v_rate * h))
    own = not is_absent(model.spring.laws)
    N = jnp.maximum(before.N, jnp.maximum(a.N, b.N) if own else normal_force(deepest, held.mode, model.spring))
    if is_absent(a.F):
        return Peaks(N, before.F)
    ends = jnp.maximum(jnp.abs(a.F), jnp.abs(b.F))
    if not model.spring.flows:
        for sign in (1.0, -1.0):
            ends = jnp.maximum(ends, _top(Rise(sign * a.F, sign * b.F, sign * a.F_rate * h, sign * b.F_rate * h)))
    return Peaks(N, jnp.maximum(before.F, jnp.where(_apart(held), 0.0, ends)))


def _apart(held: State) -> Bool[Array, ""]:
    return held.mode == Mode.APART


def _top(rise: Rise) -> Scalar:
    """The largest value of a cubic on its stretch."""
    s, inside = crest(rise)
    return jnp.maximum(jnp.maximum(rise.g_0, rise.g_1), jnp.where(inside, rise(s), rise.g_1))


def _seen(z: Motion, held: State, model: Model) -> _Seen:
    _, case, at = seat(z, held, model)
    rate, spring = touch_rates(at, z, case, model.reading), model.spring
    N, F, _ = forces(at, z, held, case, model)
    if spring.flows:
        return _Seen(at.v, rate.v, N, F, ABSENT)
    slipping = spring.mu * (slip_sign(held.mode, at.v.dtype) * spring.k * rate.v)
    F_rate = F if is_absent(F) else jnp.where(held.mode == Mode.STICK, spring.k_d * rate.u, slipping)
    return _Seen(at.v, rate.v, N, F, F_rate)
