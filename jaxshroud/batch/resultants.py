"""What contact does in the stored states of many lanes."""

import jax
import jax.numpy as jnp
import numpy as np

from jaxshroud.batch.states import inside
from jaxshroud.march.resultant import Resultant, resultant
from jaxshroud.model.absent import is_absent
from jaxshroud.model.ready import model
from jaxshroud.model.rhs import wave
from jaxshroud.model.state import State
from jaxshroud.model.trig import sincos_turns
from jaxshroud.scene.scene import Scene

BLOCK = 1024  # samples per call: one program for runs of any length


def resultants(scenes: Scene, states: State, turns: np.ndarray) -> Resultant:
    """What contact does, every number (lanes, samples); absent where the model lacks it, NaN after a lane has stopped.

    Args:
        scenes: Scenes with a leading lane axis, with contact.
        states: Their states as users have them, (lanes, samples) first; the slider brought up to date.
        turns: Phase of the drive at each sample [turns], (samples,).
    """
    count, found = len(turns), []
    for begin in range(0, count, BLOCK):
        at = np.minimum(np.arange(begin, begin + BLOCK), count - 1)
        block = jax.tree.map(lambda a, at=at: np.asarray(a)[:, at], states)
        phase = np.asarray(turns[at] % 1, states.u_s.dtype)
        found.append(jax.tree.map(np.asarray, _block(scenes, block, phase)))
    return jax.tree.map(lambda *a: np.concatenate(a, axis=1)[:, :count], *found)


@jax.jit
def _block(scenes: Scene, states: State, turns) -> Resultant:
    def one_lane(scene: Scene, states: State) -> Resultant:
        ready = model(scene)

        def one(state: State, turns) -> Resultant:
            held = inside(state, ready)
            found = resultant(wave(*sincos_turns(turns), ready.drive), held, ready)
            force = lambda a: jnp.zeros_like(found.v) if is_absent(a) else a  # noqa: E731
            lost = jnp.isnan(found.v)
            found = found._replace(N=force(found.N), F=force(found.F))
            return jax.tree.map(lambda a: jnp.where(lost, jnp.nan, a), found)

        return jax.vmap(one)(states, turns)

    return jax.vmap(one_lane)(scenes, states)
