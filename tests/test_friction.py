"""The bilinear friction element of Eq. (2)."""

from typing import NamedTuple

import equinox as eqx
import exact
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxshroud.events import Kind, crossing, first_kind, look
from jaxshroud.friction import (
    Springs,
    contact_energy,
    friction_force,
    normal_force,
    slider_speed,
    slip_sign,
    springs,
    stretch,
)
from jaxshroud.integrate import NO_SEAM
from jaxshroud.rhs import as_pairs, model
from jaxshroud.scene import vary
from jaxshroud.state import Mode, State

MODES = list(Mode)


def spring(k=1e6, k_d=3e5, mu=0.4) -> Springs:
    return Springs(*(jnp.asarray(value) for value in (k, k_d, mu, mu * k / k_d)))


class Cycle(NamedTuple):
    """A scene whose left block is led along the right block's face and back, at constant penetration."""

    model: object
    q: np.ndarray  # (n, 6)
    rate: np.ndarray  # (n, 6), of the way ahead
    u: np.ndarray  # (n,)


AMPLITUDE, STEPS = 2e-4, 64  # [m]; steps of a quarter cycle


def cycle(scene, N: float) -> Cycle:
    """Two triangular cycles of amplitude A from the middle; steps of A/64, so that every corner is a sample."""
    scene = vary(vary(scene, "contact.k", 1e6), "friction.mu", 0.5)
    sides = exact.Sides(*(float(value) for value in vars(scene.shroud).values()))
    way = np.concatenate([np.arange(STEPS), np.arange(STEPS, -STEPS, -1), np.arange(-STEPS, 0)])
    u = AMPLITUDE / STEPS * np.tile(way, 2)
    ahead = np.sign(np.roll(u, -1) - u)
    still = (0.0, 0.0)
    # height > 0 all the way, so case 3 stays; the face of the unturned right block is straight
    start = exact.placed(sides, 3, still, N / 1e6, 1e-3)
    along = exact.approach(sides, 3, still, 0.0, 1.0)
    return Cycle(as_pairs(model(scene)), start + u[:, None] * along, ahead[:, None] * along, u)


@eqx.filter_jit
def led(model, q, rate) -> jax.Array:
    """Friction force along a prescribed motion, with the transitions of `events`."""

    def step(held: State, state) -> tuple[State, jax.Array]:
        z = exact.motion(*state)
        view = look(z, held, model, NO_SEAM)
        violated = tuple(g > 0 for g in view.guards.value)
        fired = crossing(z, held, view, first_kind(violated), jnp.asarray(0.0), model).after
        held = jax.tree.map(lambda a, b: jnp.where(sum(violated) > 0, a, b), fired, held._replace_motion(z))
        return held, friction_force(view.at.v, view.at.u, held.u_s, held.mode, model.spring)
