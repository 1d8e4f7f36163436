"""Harmonic balance, plainly: forced responses that repeat in every drive period, without marching.

The motion is a Fourier series of which so many harmonics are kept. Its coefficients are found by Newton's method from
those of Eq. (1), contact and friction being evaluated at instants and transformed back (alternating frequency and
time). It shares no line with the package; torsion is left out, so that penetration and slide are linear.
"""

from typing import NamedTuple

import jax
import numpy as np
from scipy.optimize import root

SAMPLES = 1000  # in a period, of the contact forces
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


class PeriodicResponse(NamedTuple):
    """A periodic motion: coefficients of 1, cos, sin, cos 2, sin 2, ..., and samples over a period."""

    coefficients: np.ndarray  # (coordinates, 1 + 2 harmonics)
    q: np.ndarray  # (coordinates, samples)


def oscillator(scene) -> Oscillator:
    """The numbers of a scene without torsion."""
    b, d, face, friction = jax.tree.map(np.asarray, (scene.blades, scene.drive, scene.shroud, scene.friction))
    moving = [(way, i) for way in scene.parts.motion for i in range(2 if scene.parts.neighbour == "blade" else 1)]
    of_each = lambda x, y: np.array([{"x": x, "y": y}[way][i] for way, i in moving])
    left_less_right, wave = np.array([1.0, -1.0]), -1j * d.F_0 * np.exp(1j * d.phase)
    return Oscillator(
        m=of_each(b.m, b.inertia_y),
        c=of_each(b.c_x, b.c_y),
        k=of_each(b.k_x, b.k_y),
        drive=of_each(wave * np.cos(d.beta), wave * np.sin(d.beta)),
        omega=float(d.omega),
        v_q=of_each(left_less_right * np.sin(face.alpha), -left_less_right * np.cos(face.alpha)),
        u_q=of_each(left_less_right * np.cos(face.alpha), left_less_right * np.sin(face.alpha)),
        v_0=float(-face.gap * np.sin(face.alpha)),
        contact=(float(scene.k), float(friction.k_d), float(friction.mu)),
    )


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
    """The equations of so many harmonics and a mean, for one set of coefficients or a leading axis of them."""

    system: Oscillator
    order: np.ndarray  # (1 + 2 harmonics,): 0, 1, 1, 2, 2, ... of 1, cos and sin of each harmonic
    basis: np.ndarray  # (1 + 2 harmonics, samples)

    def linear_forces(self, X: np.ndarray) -> np.ndarray:
        """Coefficients of m q'' + c q' + k q."""
        turning, rate = self.order * self.system.omega, np.zeros_like(X)
        rate[..., 1::2], rate[..., 2::2] = X[..., 2::2], -X[..., 1::2]
        m, c, k = (one[:, None] for one in self.system[:3])
        return (k - m * turning**2) * X + c * turning * rate

    def drive(self) -> np.ndarray:
        """Coefficients of the drive."""
        found = np.zeros((len(self.system.m), len(self.order)))
        found[:, 1], found[:, 2] = self.system.drive.real, -self.system.drive.imag
        return found

    def contact(self, X: np.ndarray) -> np.ndarray:
        """Coefficients of the contact forces, from samples of the motion."""
        system, q = self.system, np.moveaxis(X @ self.basis, -1, 0)
        N, F = contact_forces(q @ system.v_q + system.v_0, q @ system.u_q, system.contact)
        forces = N[..., None] * system.v_q + F[..., None] * system.u_q
        weights = np.where(self.order == 0, 1.0, 2.0) / self.basis.shape[1]
        return np.moveaxis(forces, 0, -1) @ (self.basis.T * weights)

    def residual(self, rows: np.ndarray) -> np.ndarray:
        """What is left of the equations at coefficients in one row, or in many."""
        X = rows.reshape(*rows.shape[:-1], len(self.system.m), len(self.order))
        return (self.linear_forces(X) + self.contact(X) - self.drive()).reshape(rows.shape)

    def slopes(self, row: np.ndarray) -> np.ndarray:
        """The derivative of the residual, by differences of all coefficients at once."""
        push = PUSH * np.max(np.abs(row))
        return (self.residual(row + push * np.eye(row.size)) - self.residual(row)).T / push


def balanced(
    system: Oscillator, harmonics: int, guess: np.ndarray | None = None, samples: int = SAMPLES
) -> PeriodicResponse:
    """The response with so many harmonics; Newton's method starts from that with fewer, or as if nothing touched.

    Raises:
        ArithmeticError: Newton's method has found none.
    """
    order = (np.arange(2 * harmonics + 1) + 1) // 2
    phase = 2 * np.pi / samples * np.outer(order, np.arange(samples))
    basis = np.where(np.arange(len(order))[:, None] % 2 == 0, np.sin(phase), np.cos(phase))
    basis[0] = 1.0
    if guess is None:
        free = system.drive / (system.k - system.m * system.omega**2 + 1j * system.omega * system.c)
        guess = np.stack([0 * free.real, free.real, -free.imag], axis=-1)
    equations, start = Balance(system, order, basis), np.zeros((len(system.m), len(order)))
    start[:, : guess.shape[-1]] = guess
    found = root(equations.residual, start.ravel(), jac=equations.slopes, options={"xtol": 1e-12})
    if np.max(np.abs(found.fun)) > 1e-8 * np.max(np.abs(system.drive)):
        raise ArithmeticError(f"{harmonics} harmonics: {found.message}")
    X = found.x.reshape(start.shape)
    return PeriodicResponse(X, X @ basis)
