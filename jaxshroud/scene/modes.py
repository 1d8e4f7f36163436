"""Blades by their modes, as a finite-element model or a test gives them: frequencies, damping, shapes at the shroud."""

import math
import operator
from collections.abc import Sequence
from typing import Any, NamedTuple

import equinox as eqx
import numpy as np
from numpy.typing import ArrayLike

from jaxshroud.cache.programs import is_traced
from jaxshroud.scene.blades import Blades
from jaxshroud.scene.checks import InputError
from jaxshroud.scene.fields import PerBlade, per_blade, scalar
from jaxshroud.scene.keys import ALL_KEYS, MAX_MODES, MODE_KEYS
from jaxshroud.scene.laws import Number
from jaxshroud.scene.layout import COORDINATES, Parts
from jaxshroud.scene.speed import grown
from jaxshroud.scene.typed import short_repr, typed
from jaxshroud.scene.valid import check_given

SHAPES = ("phi_x", "phi_y", "phi_theta")  # of the coordinates of the shroud
LEAST_RANK = 1e-9  # of the rows of shapes: a smaller share of a row that the others leave is rounding


class BladeMode(eqx.Module):
    """One mode of each blade: its frequency and damping at rest, and its mass-normalised shape at the shroud's centre.

    c = 2 zeta omega stays as it is when omega^2 grows with the speed Omega of the rotor, by B Omega^2. A frequency of
    0 is that of a rigid motion. The disk couples equal modes of neighbours by -kappa (2 q_i - q_(i-1) - q_(i+1)): a
    ring vibrates in nodal diameter h by omega^2 + 4 kappa sin^2(pi h / N).
    """

    f: PerBlade = eqx.field(converter=per_blade)  # natural frequency [Hz]
    zeta: PerBlade = eqx.field(converter=per_blade, default=0.0)  # damping ratio
    phi_x: PerBlade = eqx.field(converter=per_blade, default=0.0)  # [kg^-1/2]
    phi_y: PerBlade = eqx.field(converter=per_blade, default=0.0)
    phi_theta: PerBlade = eqx.field(converter=per_blade, default=0.0)  # positive clockwise [rad m^-1 kg^-1/2]
    q: PerBlade | None = eqx.field(converter=per_blade, default=None)  # where it starts [m kg^1/2]; None: 0
    v: PerBlade | None = eqx.field(converter=per_blade, default=None)  # its rate there [m kg^1/2 / s]; None: 0
    sigma: PerBlade | None = eqx.field(converter=per_blade, default=None)  # stress of a unit of q; None: 0
    B: PerBlade | None = eqx.field(converter=per_blade, default=None)  # growth with the speed; None: 0
    kappa: Number | None = eqx.field(converter=scalar, default=None)  # coupling at each interface [1/s^2]; None: 0


class ModeNumbers(NamedTuple):
    """What the modes of each blade are in Eq. (1): q_j'' + c_j q_j' + k_j q_j = the shape times the forces."""

    stiffness: tuple[Any, ...]  # k_j, with mistuning and at the scene's speed [1/s^2]
    damping: tuple[Any, ...]  # c_j [1/s]
    shapes: tuple[tuple[Any, ...], ...]  # of x, y and theta, each a number of each mode
    kappa: tuple[Any, ...] = ()  # coupling at each interface [1/s^2]; empty without any
    sigma: tuple[Any, ...] = ()  # stress of a unit of each coordinate; empty without any

    def equivalent(self) -> Blades:
        """The lumped blades that the shroud feels in each coordinate alone: at once as a mass, and slowly as a spring.

        They set scales, of energy, of gamma and of steps; where the shroud does not move they are 1.
        """
        xp = self.stiffness[0].__array_namespace__()
        square = xp.stack([xp.stack(shape) for shape in self.shapes]) ** 2
        k = xp.stack(self.stiffness)
        soft = square / xp.where(k > 0, k, math.inf)  # a rigid motion bends nothing
        mass, spring = (1 / xp.where(a > 0, a, 1.0) for a in (xp.sum(square, axis=1), xp.sum(soft, axis=1)))
        damping = mass**2 * xp.sum(square * xp.stack(self.damping), axis=1)
        names = ("m", "m_y", "I", "k_x", "k_y", "k_T", "c_x", "c_y", "c_T")
        return Blades(**dict(zip(names, (*mass, *spring, *damping), strict=True)))

    @property
    def main_oscillators(self) -> dict[str, tuple[Any, Any, Any]]:
        """The mass, damping and stiffness along x, y and theta of the mode that bends most there, by NumPy arrays."""
        found = {}
        k, c = np.stack(self.stiffness), np.stack(self.damping)
        for name, shape in zip(COORDINATES, self.shapes, strict=True):
            square = np.stack(shape) ** 2
            with np.errstate(divide="ignore", invalid="ignore"):
                main = np.argmax(np.where(k > 0, square / k, 0.0), axis=0)
                found[name] = tuple(np.choose(main, a) for a in (1 / square, c / square, k / square))
        return found

    def as_blades(self) -> "ModalBlades":
        """Blades with these modes at rest, each as stiff as its coupling with neighbours makes it at most."""
        most = [4 * abs(kappa).max() for kappa in self.kappa] or [0.0] * len(self.stiffness)
        stiffness = map(operator.add, self.stiffness, most)
        numbers = zip(stiffness, self.damping, zip(*self.shapes, strict=True), strict=True)
        return ModalBlades(tuple(_mode_of(k, c, shape) for k, c, shape in numbers))


def _of_all(numbers: Sequence[Any]) -> tuple[Any, ...]:
    """A number of each mode, 0 where it is None; empty where it is of all."""
    given = [a for a in numbers if a is not None]
    return tuple(0 * given[0] if a is None else a for a in numbers) if given else ()


def _mode_of(k: Any, c: Any, shape: Sequence[Any]) -> BladeMode:
    xp = k.__array_namespace__()
    omega = xp.sqrt(k)
    zeta = xp.where(k > 0, c / (2 * xp.where(k > 0, omega, 1.0)), 0.0)
    return BladeMode(f=omega / math.tau, zeta=zeta, **dict(zip(SHAPES, shape, strict=True)))


class ModalBlades(eqx.Module):
    """Blades by n modes: the shroud's x, y and theta are the sums of phi_j q_j.

        q_j'' + 2 zeta_j omega_j q_j' + (omega_j^2 + B_j Omega^2) q_j = phi_x,j F_x + phi_y,j F_y + phi_theta,j M

    Forces and the moment are those of the drive and of contact at the shroud. Numbers are one for each blade, all of
    which have as many modes. Lumped blades are three modes with the shapes m^-1/2 in x, m_y^-1/2 in y and I^-1/2 in
    theta.
    """

    modes: tuple[BladeMode, ...]
    sigma_e: PerBlade | None = eqx.field(converter=per_blade, default=None)  # stress endured [Pa]; None: no limit
    sigma_u: PerBlade | None = eqx.field(converter=per_blade, default=None)  # strength [Pa]; None: no limit
    sigma_0: PerBlade | None = eqx.field(converter=per_blade, default=None)  # constant stress [Pa]; None: 0

    def __check_init__(self):
        modes = self.modes
        if not isinstance(modes, tuple) or not all(isinstance(mode, BladeMode) for mode in modes):
            raise InputError(f"`modes` must be a tuple of `BladeMode`s, but is {short_repr(modes)}.")
        if not 1 <= len(modes) <= MAX_MODES:
            raise InputError(f"A blade has from 1 to {MAX_MODES} modes, not {len(modes)}.")
        check_given([(ALL_KEYS[f"blades.{entry}"], value) for entry, value in self.by_entry().items()])

    def by_entry(self) -> dict[str, Any]:
        """The numbers by their entries of the table [blades], such as `modes[1].f`, without those that are None."""
        named = vars(self) | {
            f"modes[{j}].{name}": getattr(mode, name) for j, mode in enumerate(self.modes) for name in MODE_KEYS
        }
        return {entry: value for entry, value in named.items() if value is not None and entry != "modes"}

    @property
    def grow(self) -> bool:
        """Whether a frequency grows with the speed."""
        return any(mode.B is not None for mode in self.modes)

    def numbers(self, factor: Any = 1.0, square: Any = None) -> ModeNumbers:
        """What stands in Eq. (1), by NumPy or JAX.

        Args:
            factor: Of the stiffnesses at rest, by mistuning.
            square: The square of the speed [rad^2/s^2]; None: at rest.
        """
        omega = [math.tau * mode.f for mode in self.modes]
        return ModeNumbers(
            stiffness=tuple(
                grown(factor * (own * own), None if square is None else mode.B, 1.0, square)
                for own, mode in zip(omega, self.modes, strict=True)
            ),
            damping=tuple(2 * mode.zeta * own for own, mode in zip(omega, self.modes, strict=True)),
            shapes=tuple(tuple(getattr(mode, name) for mode in self.modes) for name in SHAPES),
            kappa=_of_all([mode.kappa for mode in self.modes]),
            sigma=_of_all([mode.sigma for mode in self.modes]),
        )

    def check_moves(self, parts: Parts) -> None:
        """Raise InputError unless the modes move the shroud in all coordinates of `parts.motion`, each by itself."""
        if is_traced(self.modes):
            return
        if self.motion_of(parts.motion) != parts.motion or not self._moves(parts.motion[-1]):
            still = parts.motion[-1]
            raise InputError(
                f"No mode moves the shroud in {still}, as all phi_{still} are 0; "
                f"leave {still} out of `parts.motion`, or add a mode that does."
            )
        motion = [name for name in parts.motion if self._moves(name)]
        shapes = np.stack([np.stack(self._shape(name), axis=-1) for name in motion], axis=-2).astype(float)
        shapes = shapes / np.linalg.norm(shapes, axis=-1, keepdims=True)
        rank = np.linalg.svd(shapes, compute_uv=False) > LEAST_RANK
        if rank.shape[-1] == len(motion) and rank.all():
            return
        names = " and ".join([", ".join(motion[:-1]), motion[-1]])
        n = len(self.modes)
        which = "The only mode moves" if n == 1 else f"The {n} modes move"
        raise InputError(
            f"{which} the shroud's {names} in dependence on each other; add modes, or residual vectors, until there "
            f"are {len(motion)} independent shapes, or leave {motion[-1]} out of `parts.motion`."
        )

    def motion_of(self, motion: Sequence[str]) -> tuple[str, ...]:
        """The coordinates of a `motion` without the last ones in which no mode moves the shroud."""
        moved = [name for name in COORDINATES if self._moves(name)]
        return tuple(motion[: 1 + max((i for i, name in enumerate(motion) if name in moved), default=0)])

    def _shape(self, name: str) -> list[np.ndarray]:
        return [np.asarray(getattr(mode, f"phi_{name}")) for mode in self.modes]

    def _moves(self, name: str) -> bool:
        return bool(np.any(self._shape(name)))


@typed
def modal_blades(
    f: ArrayLike,
    zeta: ArrayLike | float,
    phi: ArrayLike,
    *,
    blades: int = 2,
    B: ArrayLike | None = None,
    kappa: ArrayLike | None = None,
) -> ModalBlades:
    """Blades by arrays of their modes.

    Args:
        f: Natural frequencies at rest (n,) [Hz], or (n, blades) of unlike blades.
        zeta: Damping ratios, likewise, or one for all.
        phi: Mass-normalised shapes at the shroud's centre, (3, n) or (3, n, blades): of x and y [kg^-1/2] and of theta,
            positive clockwise [rad m^-1 kg^-1/2].
        blades: The number of blades.
        B: Growth of omega^2 with the square of the speed, as `f`; None: 0.
        kappa: Coupling with the same mode of neighbours [1/s^2], (n,) in a pair, (n, interfaces) in a row; None: 0.

    Raises:
        InputError: The arrays are not of the same modes.
        SceneError: A number is out of its range.
    """
    shape = (len(np.atleast_1d(np.asarray(f))), blades)

    def each(a: Any) -> np.ndarray:
        a = np.asarray(a, float)
        try:
            return np.broadcast_to(a[:, None] if a.ndim == 1 else a, shape)
        except ValueError:
            raise InputError(
                f"Arrays of {shape[0]} modes of {blades} blades have other shapes, not {a.shape}."
            ) from None

    rows = np.asarray(phi, float)
    if rows.ndim not in (2, 3) or len(rows) != len(SHAPES):
        raise InputError(f"Argument `phi` must be the shapes of x, y and theta, (3, n), but its shape is {rows.shape}.")
    numbers = {"f": each(f), "zeta": each(zeta), **dict(zip(SHAPES, map(each, rows), strict=True))}
    if B is not None:
        numbers["B"] = each(B)
    if kappa is not None:
        numbers["kappa"] = np.asarray(kappa, float)
    return ModalBlades(tuple(BladeMode(**{name: a[j] for name, a in numbers.items()}) for j in range(shape[0])))
