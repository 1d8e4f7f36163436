"""Harmonic balance, plainly: forced responses that repeat in every drive period, without marching.

The motion is a Fourier series of which so many harmonics are kept. Its coefficients are found by Newton's method from
those of Eq. (1), contact and friction being evaluated at instants and transformed back (alternating frequency and
time). It shares no line with the package; torsion is left out, so that penetration and slide are linear.
"""

from typing import NamedTuple

import numpy as np
from scipy.optimize import root

SAMPLES = 1024  # in a period, of the contact forces
PUSH = 1e-7  # of the largest coefficient, of differences


class Oscillator(NamedTuple):
    """m q'' + c q' + k q + v_q N + u_q F = Re(drive e^(i omega t)), for q = (x_1, x_2, y_1, y_2) or fewer."""

    m: np.ndarray
    c: np.ndarray
    k: np.ndarray
    drive: np.ndarray  # complex
    omega: float
    v_q: np.ndarray  # of the penetration v = v_q q + v_0
    u_q: np.ndarray  # of the slide u = u_q q
    v_0: float
    contact: tuple[float, float, float]  # k, k_d, mu


class Response(NamedTuple):
    """A periodic motion: coefficients of 1, cos and sin of each harmonic, and samples over a period."""

    coefficients: np.ndarray  # (coordinates, 1 + 2 harmonics)
    q: np.ndarray  # (coordinates, samples)


def oscillator(scene) -> Oscillator:
    """The numbers of a scene without torsion."""
    blades = range(2 if scene.parts.neighbour == "blade" else 1)
    part = [(name, i) for name in scene.parts.motion for i in blades]
    b, d, alpha, sides = scene.blades, scene.drive, float(scene.shroud.alpha), (1.0, -1.0)
    of_blades = {"m_x": b.m, "m_y": b.inertia_y, "c_x": b.c_x, "c_y": b.c_y, "k_x": b.k_x, "k_y": b.k_y}
    m, c, k = (np.array([float(of_blades[f"{letter}_{name}"][i]) for name, i in part]) for letter in "mck")
    turned = {"x": np.cos(d.beta), "y": np.sin(d.beta)}
    drive = np.array([complex(-1j * d.F_0[i] * turned[name][i] * np.exp(1j * d.phase[i])) for name, i in part])
    across, along = {"x": np.sin(alpha), "y": -np.cos(alpha)}, {"x": np.cos(alpha), "y": np.sin(alpha)}
    v_q, u_q = (np.array([sides[i] * face[name] for name, i in part]) for face in (across, along))
    springs = float(scene.k), float(scene.friction.k_d), float(scene.friction.mu)
    return Oscillator(m, c, k, drive, float(d.omega), v_q, u_q, -float(scene.shroud.gap) * np.sin(alpha), springs)


def contact_forces(v: np.ndarray, u: np.ndarray, contact: tuple[float, float, float]) -> tuple[np.ndarray, np.ndarray]:
    """The normal and the friction force at samples (along axis 0) of a motion that repeats: Eq. (2).

    From one sample to the next the friction spring is stretched by the slide, up to what friction holds: nothing while
    apart. Two periods, for the stretch at the start of the first is not known.
    """
    k, k_d, mu = contact
    N = k * np.maximum(v, 0.0)
    most = mu * N
    slid = k_d * (u - np.roll(u, 1, axis=0))
    F = np.empty_like(u)
    force = np.zeros_like(u[0])
    for i in (*range(len(u)), *range(len(u))):
        force = np.minimum(np.maximum(force + slid[i], -most[i]), most[i])
        F[i] = force
    return N, F


class Balance(NamedTuple):
    """The equations of so many harmonics and a mean, for sets of coefficients in one row or many."""

    system: Oscillator
    basis: np.ndarray  # (1 + 2 harmonics, samples): 1, cosines and sines
    order: np.ndarray  # of the harmonic of each coefficient

    def stiffness(self, X: np.ndarray) -> np.ndarray:
        """What the blades alone take of coefficients (..., coordinates, 1 + 2 harmonics)."""
        system, turning = self.system, self.order * self.system.omega
        half = len(self.order) // 2
        rate = np.concatenate([0 * X[..., :1], X[..., half + 1 :], -X[..., 1 : half + 1]], axis=-1) * turning
        return (system.k[:, None] - system.m[:, None] * turning**2) * X + system.c[:, None] * rate

    def drive(self) -> np.ndarray:
        """Coefficients of the drive."""
        found = np.zeros((len(self.system.m), len(self.order)))
        found[:, 1], found[:, len(self.order) // 2 + 1] = self.system.drive.real, -self.system.drive.imag
        return found

    def contact(self, X: np.ndarray) -> np.ndarray:
        """Coefficients of the contact forces, from samples of the motion."""
        system, q = self.system, np.moveaxis(X @ self.basis, -1, 0)
        N, F = contact_forces(q @ system.v_q + system.v_0, q @ system.u_q, system.contact)
        forces = N[..., None] * system.v_q + F[..., None] * system.u_q
        weights = np.where(self.order == 0, 1.0, 2.0) / self.basis.shape[1]
        return np.moveaxis(forces, 0, -1) @ (self.basis.T * weights)

    def residual(self, rows: np.ndarray) -> np.ndarray:
        """What is left of the equations."""
        X = rows.reshape(*rows.shape[:-1], len(self.system.m), len(self.order))
        return (self.stiffness(X) + self.contact(X) - self.drive()).reshape(rows.shape)

    def slopes(self, row: np.ndarray) -> np.ndarray:
        """The derivative of the residual, by differences of all coefficients at once."""
        push = PUSH * np.max(np.abs(row))
        return (self.residual(row + push * np.eye(row.size)) - self.residual(row)).T / push


def balanced(system: Oscillator, harmonics: int, guess: np.ndarray | None = None, samples: int = SAMPLES) -> Response:
    """The response with so many harmonics; Newton's method starts from a guess, or as if nothing touched."""
    one = np.arange(1, harmonics + 1)
    phase = 2 * np.pi / samples * np.outer(one, np.arange(samples))
    basis = np.concatenate([np.ones((1, samples)), np.cos(phase), np.sin(phase)])
    equations = Balance(system, basis, np.concatenate([[0], one, one]))
    if guess is None:
        free = system.drive / (system.k - system.m * system.omega**2 + 1j * system.omega * system.c)
        guess = np.stack([0 * free.real, free.real, -free.imag], axis=-1)
    known = (guess.shape[-1] - 1) // 2
    start = np.zeros((len(system.m), len(basis)))
    start[:, : known + 1], start[:, harmonics + 1 : harmonics + known + 1] = guess[:, : known + 1], guess[:, known + 1 :]
    found = root(equations.residual, start.ravel(), jac=equations.slopes, options={"xtol": 1e-12})
    if np.max(np.abs(found.fun)) > 1e-8 * np.max(np.abs(system.drive)):
        raise ArithmeticError(f"{harmonics} harmonics: {found.message}")
    X = found.x.reshape(start.shape)
    return Response(X, X @ basis)
