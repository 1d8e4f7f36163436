"""Tangents of rollouts against differences, and why some differ: python tests/studies/slopes.py.

The forces, displacements and powers of a rollout by gap, stiffness ratio, friction and force amplitude, in 32 lanes
each of three models: bending in x, all four cases, and realistic blades with flat contact. A difference counts where
quotients of neighbouring steps agree to 1e-7 of the largest slope (see `tests/quotients.py`); elsewhere an event that
falls on the end of a step puts kinks nearer than rounding lets one look.

An event's instant moves with the solution's slope where the trial ends, that of the computed step being another by
the method's error. The tangent meets the event three times, so that only the third power of this is left; where a guard
is hardly crossed, as between nearly parallel faces, the second is not small. The last model is marched by two methods.
"""

import json
import sys
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))
from quotients import quotients
from side_by_side import with_parts

import jaxshroud as js

KEYS = ("shroud.gap", "contact.gamma", "friction.mu", "drive.F_0")
KNOWN = 1e-7
LANES = 32
NARROW = ('blades.I="block"', 'drive.M_0="0.5 N m"')


class Case(NamedTuple):
    """A model, and how it is marched."""

    options: tuple[str, ...]
    motion: tuple[str, ...]
    periods: int
    steps: int
    method: str


CASES = {
    "bending in x": Case((), ("x",), 1, 200, "rk4"),
    "four cases": Case((), ("x", "y", "theta"), 2, 400, "rk4"),
    "flat contact": Case(NARROW, ("x", "y", "theta"), 1, 800, "rk4"),
    "flat contact, Dormand-Prince 8": Case(NARROW, ("x", "y", "theta"), 1, 800, "dopri8"),
}


def observed(numbers: jax.Array, case: Case) -> jax.Array:
    """Contact forces, displacements and power, each over its size."""
    options = ["contact.gamma=2.5", "drive.F_0=60", *case.options]
    scene = with_parts(js.load("table1", options).scene, motion=case.motion)
    for i, key in enumerate(KEYS):
        scene = js.vary(scene, key, numbers[i])
    save = lambda m: (m.N / 100, m.F / 100, m.state.motion.x / 1e-4, m.state.motion.y / 1e-4)
    method = js.RungeKutta(case.method)
    how = {"every": case.steps // 4, "method": method.replace(steps=case.steps)}
    run = js.rollout(scene, None, case.periods, save=save, **how)
    return jnp.concatenate([jnp.ravel(a) for a in (*run.saved, run.power / 1e-8)])


def figures(case: Case, gamma: np.ndarray) -> dict[str, Any]:
    """How many derivatives differences know, and how far tangents are from these."""
    numbers = jnp.asarray([(22e-6, g, 0.5, 60.0) for g in gamma])
    f = partial(observed, case=case)
    found = quotients(jax.jit(jax.vmap(f)), numbers)
    error = found.error(np.asarray(jax.jit(jax.vmap(jax.jacfwd(f)))(numbers)))
    known = found.doubt < KNOWN
    off = [
        {"gamma": float(gamma[i]), "by": KEYS[j], "error": float(error[i, j]), "doubt": float(found.doubt[i, j])}
        for i, j in np.argwhere(error >= 1e-6)
    ]
    return {
        "derivatives": error.size,
        "known": int(known.sum()),
        "known, and off by 1e-6 or more": int(np.sum(known & (error >= 1e-6))),
        "largest error of those known": float(np.max(error[known])),
        "unknown, and off by 1e-6 or more": int(np.sum(~known & (error >= 1e-6))),
        "off": off,
    }


def main() -> None:
    """All cases."""
    jax.config.update("jax_enable_x64", True)
    told: dict[str, Any] = {"command": "python tests/studies/slopes.py", "version": js.__version__}
    for name, case in CASES.items():
        told[name] = figures(case, np.linspace(1.0, 15.0, LANES))
        print(name, json.dumps(told[name], indent=1), flush=True)
    Path(__file__).with_suffix(".json").write_text(json.dumps(told, indent=1) + "\n", "utf-8")


if __name__ == "__main__":
    main()
