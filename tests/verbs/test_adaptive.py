"""Adaptive solvers of diffrax, explicit and implicit, on scenes that are valid input for them: those without events."""

import numpy as np
import pytest
from side_by_side import ends, relative_error, run, sizes, with_parts

from jaxshroud.batch.xla import one_lane
from jaxshroud.march.method import FAST_WITH_LEDGER
from jaxshroud.march.stability import largest_frequency
from jaxshroud.orbits.short_runs import adaptive_runs, motions_at
from jaxshroud.scene.vary import vary


def solved(scene, solver: str, rtol: float) -> np.ndarray:
    """The motion after one period from the scene's start, (12,)."""
    return motions_at(adaptive_runs(one_lane(scene), 1, solver, rtol).samples, 0)[0]


SOLVERS = {
    "explicit": ("Dopri8", 1e-11, 1e-7, {"motion": ("x", "y")}),
    "implicit": ("Kvaerno5", 1e-7, 1e-3, {"motion": ("x",), "friction": "none"}),
}


@pytest.mark.full
@pytest.mark.parametrize("kind", SOLVERS)
def test_smooth_contact(table1, kind):
    # The same right-hand side, another way through time. The motion amplifies errors some thousandfold in a period.
    solver, rtol, agree, parts = SOLVERS[kind]
    scene = with_parts(vary(table1, "contact.gamma", 2.5), 2e-6, contact="smooth", **parts)
    steps = int(float(largest_frequency(scene) * scene.drive.period) / 0.1)
    ours = run([scene], 1, steps, FAST_WITH_LEDGER)
    size = np.maximum(sizes(ours)[0], 1e-300)
    error = relative_error(ends(ours)[0], solved(scene, solver, rtol), size)
    assert error < agree
    # Control: the spring's law is another scene.
    spring = run([with_parts(vary(table1, "contact.gamma", 2.5), **parts)], 1, 1000, FAST_WITH_LEDGER)
    assert relative_error(ends(spring)[0], ends(ours)[0], size) > 10 * error
