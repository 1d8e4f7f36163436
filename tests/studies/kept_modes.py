"""How many modes are enough where blades touch: python tests/studies/kept_modes.py

Two beams of 40 elements with a block at their ends touch and rub along y. Of five periodic orbits, P_d and the
amplitude of x by 3, 6 and 13 modes, with residual vectors and without, are compared with those of 200 modes, which
plain NumPy marches: each mode exactly, under forces that are linear within a step. `kept_modes.json` has the answers.
"""

import json
import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.linalg import eigh

sys.path.insert(0, str(Path(__file__).parents[1]))
import beam_model

FILE = Path(__file__).with_suffix(".json")
ELEMENTS, MODES, ZETA = 40, 200, 0.05
SPAN, MASS, INERTIA = 0.2, 0.2, 5e-5  # of the blade [m] and of the block at its end [kg, kg m^2]
TIP = str(ELEMENTS)
K_CONTACT, K_D, MU = 2e6, 1e6, 0.3
FORCE, BETA = 40.0, np.radians(30.0)
SPEEDS = 2 * np.pi * np.array([140.0, 150.0, 200.0, 200.0, 150.0])  # of the drive [rad/s]
GAPS = np.array([1e-5, 1e-5, 1e-5, 3e-5, 6e-5])
KEPT = (3, 6, 13)
STEPS, TRANSIENT = 6000, 80


class Beam(NamedTuple):
    """Matrices of a beam, with what its unknowns are."""

    K: np.ndarray
    M: np.ndarray
    labels: list[str]
    nodes: dict[str, np.ndarray]


def beam() -> Beam:
    """A beam along z with a block at its end; node 0 is the root."""
    nodes = {str(i): np.array([0.0, 0.0, z]) for i, z in enumerate(np.linspace(0, SPAN, ELEMENTS + 1))}
    K, M = np.zeros((2, 6 * len(nodes), 6 * len(nodes)))
    section = beam_model.section(beam_model.THICKNESS, beam_model.CHORD)
    for i in range(ELEMENTS):
        at = slice(6 * i, 6 * i + 12)
        k, m = beam_model.element((nodes[str(i)], nodes[str(i + 1)]), [1, 0, 0], section)
        K[at, at] += k
        M[at, at] += m
    tip = np.arange(6 * ELEMENTS, 6 * ELEMENTS + 6)
    M[tip, tip] += [MASS, MASS, MASS, INERTIA, INERTIA, INERTIA]
    return Beam(K, M, [f"{node}.{i}" for node in nodes for i in range(1, 7)], nodes)


def reference() -> tuple[np.ndarray, np.ndarray]:
    """P_d [%] and the amplitude of x [m] of the left blade on the five orbits, by 200 modes."""
    model = beam()
    squares, shapes = eigh(model.K[6:, 6:], model.M[6:, 6:], subset_by_index=[0, MODES - 1])
    phi = shapes[6 * (ELEMENTS - 1) : 6 * (ELEMENTS - 1) + 2]  # of x and y
    omega = np.sqrt(squares)
    lanes = len(SPEEDS)
    h = 2 * np.pi / SPEEDS / STEPS
    step = _oscillators(omega, h)
    load = FORCE * np.array([np.cos(BETA), np.sin(BETA)]) @ phi  # (modes,)
    sides = np.array([1.0, -1.0])  # in antiphase
    q, rate = np.zeros((2, lanes, 2, MODES))
    slider = np.zeros(lanes)
    touched = np.zeros(lanes, bool)
    contact = np.zeros((lanes, 2))
    kept = []

    def forces(phase, contact):
        swing = np.sin(phase) * sides[:, None] * load  # (2, modes)
        return swing + sides[:, None] * (contact @ phi)[:, None]

    for i in range((TRANSIENT + 1) * STEPS):
        before = forces(2 * np.pi * i / STEPS, contact)
        after = forces(2 * np.pi * (i + 1) / STEPS, contact)
        for _ in range(2):
            moved = [f[0] * q + f[1] * rate + f[2] * before + f[3] * after for f in step]
            x, y = np.moveaxis(moved[0] @ phi.T, -1, 0)
            new, new_slider, touches = _contact(x, y, slider, touched)
            after = forces(2 * np.pi * (i + 1) / STEPS, new)
        q, rate = (f[0] * q + f[1] * rate + f[2] * before + f[3] * after for f in step)
        contact, slider, touched = new, new_slider, touches
        if i >= TRANSIENT * STEPS:
            kept.append((q[:, 0] @ phi.T).T)
    x, y = np.moveaxis(np.array(kept), 1, 0)
    free = np.stack([phi @ (load / (squares - w**2 + 2j * ZETA * omega * w)) for w in SPEEDS], axis=-1)
    P_0 = np.sum(np.abs(free) ** 2, axis=0) / 2
    return 100 * (1 - np.mean(x**2 + y**2, axis=0) / P_0), np.max(np.abs(x - np.mean(x, axis=0)), axis=0)


def _contact(x, y, slider, touched):
    """The forces (lanes, 2) on the left blade, the slider, and whether there is contact."""
    v = x[:, 0] - x[:, 1] - GAPS
    u = y[:, 0] - y[:, 1]
    N = K_CONTACT * np.maximum(v, 0.0)
    slider = np.where(touched, slider, u)
    F = np.clip(K_D * (u - slider), -MU * N, MU * N)
    return np.stack([-N, -F], axis=-1), u - F / K_D, v > 0


def _oscillators(omega, h):
    """What q and q' become after a step h: factors of q, q' and of the forces at both ends, (lanes, 1, modes) each.

    The forces are linear within a step, and with them the motion about a particular solution is free.
    """
    w, c = omega, 2 * ZETA * omega
    h = h[:, None, None]
    damped = w * np.sqrt(1 - ZETA**2)
    fade = np.exp(-ZETA * w * h)
    s, co = np.sin(damped * h) / damped, np.cos(damped * h)
    A, B = fade * (co + ZETA * w * s), fade * s  # place by place, by rate
    C, D = -(w**2) * B, fade * (co - ZETA * w * s)  # rate by place, by rate
    # q_p = (f_0 + (f_1 - f_0) t / h) / w^2 - c (f_1 - f_0) / (h w^4)
    start = {"f_0": (1 + c / (h * w**2)) / w**2, "f_1": -c / (h * w**4)}
    end = {"f_0": c / (h * w**4), "f_1": (1 - c / (h * w**2)) / w**2}
    slope = {"f_0": -1 / (h * w**2), "f_1": 1 / (h * w**2)}
    place = [end[f] - A * start[f] - B * slope[f] for f in ("f_0", "f_1")]
    rates = [slope[f] - C * start[f] - D * slope[f] for f in ("f_0", "f_1")]
    return (A, B, *place), (C, D, *rates)


def by_modes(count: int, residuals: bool) -> dict:
    """The same by modes that are kept, marched by the package."""
    import jax

    jax.config.update("jax_enable_x64", True)
    import dataclasses

    import jaxshroud as js

    model = beam()
    blade = js.reduce(
        *(model.K, model.M),
        dofs=model.labels,
        nodes=model.nodes,
        shroud=[TIP],
        fixed=["0"],
        n_modes=count,
        zeta=ZETA,
        residuals=residuals,
    )
    parts = ['parts.motion=["x", "y"]', "shroud.alpha=90 deg", f"drive.F_0={FORCE}", f"drive.beta={BETA}"]
    base = js.load("table1", [*parts, f"contact.k={K_CONTACT}", f"friction.k_d={K_D}", f"friction.mu={MU}"]).scene
    scene = dataclasses.replace(base, blades=blade.blades())
    scenes = js.scenes_from({"drive.omega": SPEEDS, "shroud.gap": GAPS}, scene)
    run = js.sweep(scenes, n_periods=2, transient=TRANSIENT, method="balanced", amplitudes=True)
    return {
        "modes": len(blade.f),
        "P_d": run.P_d.tolist(),
        "x_peak": run.x_peak[:, 0].tolist(),
        "period": run.period_number.tolist(),
    }


def main() -> None:
    """Compute all and store it."""
    P_d, x_peak = reference()
    found = {"reference": {"P_d": P_d.tolist(), "x_peak": x_peak.tolist()}}
    print(found, flush=True)
    for count in KEPT:
        for residuals in (True, False):
            name = f"{count} modes{' and residual vectors' * residuals}"
            one = by_modes(count, residuals)
            one["error of the power"] = float(np.max(np.abs((np.array(one["P_d"]) - P_d) / (100 - P_d))))
            one["error of x_peak"] = float(np.max(np.abs(np.array(one["x_peak"]) / x_peak - 1)))
            found[name] = one
            print(name, one, flush=True)
    FILE.write_text(json.dumps(found, indent=1) + "\n", "utf-8")


if __name__ == "__main__":
    main()
