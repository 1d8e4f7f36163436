"""The drive of a scene: its frequency, its force and moment on each blade by harmonics, and their engine order."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import equinox as eqx
import jax

from jaxshroud.scene.checks import InputError, word_argument
from jaxshroud.scene.fields import PerBlade, per_blade, scalar
from jaxshroud.scene.keys import ALL_KEYS, COMPLEX_KEYS, MODAL_LOAD_KEYS, OF_HARMONIC, SINGLE_LOADS
from jaxshroud.scene.laws import Number
from jaxshroud.scene.valid import check_given, check_numbers

FIELDS_OF_LOADS = {"x": "F_x", "y": "F_y", "theta": "M_0"}  # of the coordinates
SINGLE_KEYS = tuple(f"drive.{name}" for name in SINGLE_LOADS)


def _parts_of(load: Any, phase: Any) -> tuple[Any, Any]:
    xp = phase.__array_namespace__()
    return load * xp.cos(phase), load * xp.sin(phase)


class DriveHarmonic(NamedTuple):
    """A force `F_0 sin(n omega t + phase)` at an angle `beta` to x, and a moment `M_0 sin(...)`, of each blade.

    Harmonic 0 is a constant load, `F_0 sin(phase)`.
    """

    beta: PerBlade  # direction of the force [rad]
    F_0: PerBlade  # force amplitude [N]
    M_0: PerBlade  # moment amplitude [N m]
    phase: PerBlade  # [rad]

    @property
    def F_x(self) -> Any:
        """The amplitude of the force along x [N], by NumPy or JAX."""
        return self.F_0 * self.beta.__array_namespace__().cos(self.beta)

    @property
    def F_y(self) -> Any:
        """The amplitude of the force along y [N], by NumPy or JAX."""
        return self.F_0 * self.beta.__array_namespace__().sin(self.beta)

    def load(self, name: str) -> Any:
        """The amplitude of the force along x or y [N], or of the moment on theta [N m]."""
        return getattr(self, FIELDS_OF_LOADS[name])

    def parts(self, name: str) -> tuple[Any, Any]:
        """The real and the imaginary part of the complex amplitude of a load, by NumPy or JAX."""
        return _parts_of(self.load(name), self.phase)


class ComplexLoad(NamedTuple):
    """Loads of each blade by complex amplitudes Q: the imaginary part of Q exp(i (n omega t + phase))."""

    F_x_re: PerBlade  # [N]
    F_x_im: PerBlade
    F_y_re: PerBlade
    F_y_im: PerBlade
    M_re: PerBlade  # [N m]
    M_im: PerBlade
    phase: PerBlade  # [rad]
    modal: Mapping[str, PerBlade]  # `Q0_re` and so on, of modes of blades [N kg^-1/2]

    @property
    def amplitudes(self) -> tuple[Any, ...]:
        """All parts of the amplitudes."""
        return *self[:6], *self.modal.values()

    @property
    def F_x(self) -> Any:
        """The amplitude of the force along x [N], by NumPy or JAX."""
        return _modulus(self.F_x_re, self.F_x_im)

    @property
    def F_y(self) -> Any:
        """The amplitude of the force along y [N], by NumPy or JAX."""
        return _modulus(self.F_y_re, self.F_y_im)

    @property
    def M_0(self) -> Any:
        """The amplitude of the moment [N m], by NumPy or JAX."""
        return _modulus(self.M_re, self.M_im)

    def load(self, name: str) -> Any:
        """The amplitude of the force along x or y [N], or of the moment on theta [N m]."""
        return getattr(self, FIELDS_OF_LOADS[name])

    def in_phase_and_quadrature(self, name: str) -> tuple[Any, Any]:
        """The parts of a load, also `Q0` of a mode, that go with the sine and with the cosine of its phase."""
        if name not in FIELDS_OF_LOADS:
            none = 0 * self.phase
            return self.modal.get(f"{name}_re", none), self.modal.get(f"{name}_im", none)
        stem = FIELDS_OF_LOADS[name].removesuffix("_0")
        return getattr(self, f"{stem}_re"), getattr(self, f"{stem}_im")

    def parts(self, name: str) -> tuple[Any, Any]:
        """The real and the imaginary part of the complex amplitude of a load, by NumPy or JAX."""
        re, im = self.in_phase_and_quadrature(name)
        s, c = (getattr(self.phase.__array_namespace__(), f)(self.phase) for f in ("sin", "cos"))
        return re * c - im * s, re * s + im * c


def _modulus(re: Any, im: Any) -> Any:
    return (re**2 + im**2) ** 0.5


class MeanLoad(NamedTuple):
    """A constant force and moment of each blade: the harmonic of order 0."""

    F_x: PerBlade  # [N]
    F_y: PerBlade  # [N]
    M_0: PerBlade  # [N m]

    @property
    def phase(self) -> Any:
        """A quarter of a turn, at which a harmonic of order 0 has its amplitude, by NumPy or JAX."""
        return 0 * self.F_x + math.pi / 2

    def load(self, name: str) -> Any:
        """The force along x or y [N], or the moment on theta [N m]."""
        return getattr(self, FIELDS_OF_LOADS[name])

    def parts(self, name: str) -> tuple[Any, Any]:
        """The load as that of a harmonic."""
        return _parts_of(self.load(name), self.phase)


class Harmonic(eqx.Module):
    """One harmonic of a drive: `F sin(n (omega t + phi) + phase)` at an angle `beta` to x, and the moment `M sin(...)`.

    phi is the phase of the drive itself, of each blade.
    """

    order: int = eqx.field(static=True)  # n, of which the frequency is n omega
    F: PerBlade = eqx.field(converter=per_blade)  # force amplitude [N]
    beta: PerBlade = eqx.field(converter=per_blade)  # direction of the force [rad]
    M: PerBlade = eqx.field(converter=per_blade, default=0.0)  # moment amplitude [N m]
    phase: PerBlade | None = eqx.field(converter=per_blade, default=None)  # psi [rad]; None: 0
    by_engine_order: bool = eqx.field(static=True, default=False)  # whether n follows the engine order of the drive

    def under(self, phase: Any, level: Any) -> DriveHarmonic:
        """The force and the moment under the phase and the level of the drive, by NumPy or JAX."""
        own = phase if self.order == 1 else self.order * phase
        own = own if self.phase is None else own + self.phase
        return DriveHarmonic(self.beta, _at_level(level, self.F), _at_level(level, self.M), own)


def _modal_loads(loads: Mapping[str, Any]) -> dict[str, Any]:
    for name in loads:
        word_argument("modal", name, MODAL_LOAD_KEYS)
    return {name: per_blade(load) for name, load in loads.items()}


class ComplexHarmonic(eqx.Module):
    """One harmonic of a drive by complex amplitudes Q: the imaginary part of Q exp(i n (omega t + phi)).

    Forces along x and y and the moment each have a phase of their own: the real part of an amplitude goes with the
    sine, its imaginary part with the cosine. phi is the phase of the drive itself, of each blade. Loads may act on
    modes of the blades themselves: `Q2_re` and `Q2_im` of `modal` on mode 2 [N kg^-1/2].
    """

    order: int = eqx.field(static=True)  # n, of which the frequency is n omega
    F_x_re: PerBlade = eqx.field(converter=per_blade, default=0.0)  # [N]
    F_x_im: PerBlade = eqx.field(converter=per_blade, default=0.0)
    F_y_re: PerBlade = eqx.field(converter=per_blade, default=0.0)
    F_y_im: PerBlade = eqx.field(converter=per_blade, default=0.0)
    M_re: PerBlade = eqx.field(converter=per_blade, default=0.0)  # [N m]
    M_im: PerBlade = eqx.field(converter=per_blade, default=0.0)
    by_engine_order: bool = eqx.field(static=True, default=False)  # whether n follows the engine order of the drive
    modal: dict[str, PerBlade] = eqx.field(converter=_modal_loads, default_factory=dict)

    @property
    def amplitudes(self) -> tuple[Any, ...]:
        """All parts of the amplitudes."""
        return (*(getattr(self, name) for name in COMPLEX_KEYS), *self.modal.values())

    def under(self, phase: Any, level: Any) -> ComplexLoad:
        """The force and the moment under the phase and the level of the drive, by NumPy or JAX."""
        loads = {name: _at_level(level, getattr(self, name)) for name in COMPLEX_KEYS}
        modal = {name: _at_level(level, load) for name, load in self.modal.items()}
        return ComplexLoad(**loads, phase=phase if self.order == 1 else self.order * phase, modal=modal)


def _at_level(level: Any, load: Any) -> Any:
    return load if level is None else level[..., None] * load


AnyLoad = DriveHarmonic | ComplexLoad | MeanLoad
Harmonics = dict[int, AnyLoad]  # by order


class Drive(eqx.Module):
    """The force `Q_i = F_0 sin(omega t + phase)` at an angle `beta` to x, and the moment `M_0 sin(...)` (Sec. 3.1).

    There may be a constant load beside it, which is order 0 of its harmonics. In the place of the sine there may be any
    number of harmonics of the frequency omega, each with a direction and loads of its own; then `beta`, `F_0` and `M_0`
    are None.

    A drive of your own is a class derived from this one, with fields of further numbers, whose `harmonics` are these
    fields. Everything else, from the march to the closed form without contact, follows from them. Files cannot name it.
    """

    omega: Number = eqx.field(converter=scalar)  # circular frequency, common to both blades [rad/s]
    beta: PerBlade | None = eqx.field(converter=per_blade)  # direction of the force [rad]
    F_0: PerBlade | None = eqx.field(converter=per_blade)  # force amplitude [N]
    M_0: PerBlade | None = eqx.field(converter=per_blade)  # moment amplitude [N m]
    phase: PerBlade = eqx.field(converter=per_blade)  # the paper's phi_1, phi_2 [rad]
    level: Number | None = eqx.field(converter=scalar, default=None, kw_only=True)  # factor of all harmonics; None: 1
    F_x_mean: PerBlade | None = eqx.field(converter=per_blade, default=None, kw_only=True)  # mean load [N]; None: 0
    F_y_mean: PerBlade | None = eqx.field(converter=per_blade, default=None, kw_only=True)  # [N]
    M_mean: PerBlade | None = eqx.field(converter=per_blade, default=None, kw_only=True)  # mean moment [N m]
    harmonic: tuple[Harmonic | ComplexHarmonic, ...] | None = eqx.field(
        default=None, kw_only=True
    )  # None: the one of F_0 and M_0

    def __check_init__(self):
        listed = () if self.harmonic is None else self.harmonic
        if not isinstance(listed, tuple) or not all(isinstance(one, Harmonic | ComplexHarmonic) for one in listed):
            raise InputError("`harmonic` must be None or a tuple of `Harmonic`s and `ComplexHarmonic`s.")
        orders = [one.order for one in listed]
        if (
            self.harmonic == ()
            or len(set(orders)) < len(orders)
            or not all(isinstance(n, int) and n > 0 for n in orders)
        ):
            raise InputError(f"The orders of harmonics must be different positive whole numbers, but are {orders}.")
        if orders and any(load is not None for load in (self.beta, self.F_0, self.M_0)):
            raise InputError("A drive with harmonics has no `beta`, `F_0` and `M_0` beside them: they must be None.")
        check_numbers("drive", self, SINGLE_KEYS if orders else ())
        check_given([(ALL_KEYS[f"drive.{name}"], value) for name, value in self.of_harmonics().items()])

    @property
    def period(self) -> Number:
        """The forcing period T = 2 pi / omega [s]."""
        return 2 * math.pi / self.omega

    def of_harmonics(self) -> dict[str, Any]:
        """The numbers of the harmonics by their names, such as `harmonic[1].F`, without those that are None."""
        return {
            f"harmonic[{i}].{name}": value
            for i, one in enumerate(self.harmonic or ())
            for name, value in {**vars(one), **getattr(one, "modal", {})}.items()
            if name in OF_HARMONIC and value is not None
        }

    def harmonics(self) -> Harmonics:
        """The force and the moment by the order n of their frequency n omega. Their numbers are fields of the drive."""
        mean = self._mean_load()
        return self._sines() if mean is None else {**self._sines(), 0: mean}

    def _mean_load(self) -> MeanLoad | None:
        loads = (self.F_x_mean, self.F_y_mean, self.M_mean)
        given = next((load for load in loads if load is not None), None)
        return None if given is None else MeanLoad._make(0 * given if load is None else load for load in loads)

    def _sines(self) -> Harmonics:
        if self.harmonic is not None:
            return {one.order: one.under(self.phase, self.level) for one in self.harmonic}
        assert self.beta is not None  # without a list of harmonics
        F, M = _at_level(self.level, self.F_0), _at_level(self.level, self.M_0)
        return {1: DriveHarmonic(self.beta, F, M, self.phase)}

    @property
    def _is_own(self) -> bool:
        """Whether the harmonics are those of a class of your own, all of whose numbers are fields."""
        return type(self).harmonics is not Drive.harmonics

    def frequency(self, order: int) -> Number:
        """The circular frequency of a harmonic [rad/s]."""
        return self.omega if order == 1 else order * self.omega

    def of_blades(self, blades: Any) -> "Drive":
        """The drive of some `blades` of a row, by their indices."""
        return jax.tree.map(lambda a: a[blades] if a.ndim else a, self)

    def advanced(self, phase: float) -> "Drive":
        """The same drive with its phase omega t advanced by `phase` [rad]."""
        if not self._is_own:
            return eqx.tree_at(lambda drive: drive.phase, self, self.phase + phase)

        def phases(drive):
            return [harmonic.phase for harmonic in drive.harmonics().values()]

        return eqx.tree_at(
            phases, self, [own + n * phase for n, own in zip(self.harmonics(), phases(self), strict=True)]
        )

    def scaled(self, factor: float) -> "Drive":
        """The same drive with all forces and moments but mean loads times a `factor`."""

        def loads(drive):
            return [load for one in drive.own_loads() for load in one]

        return eqx.tree_at(loads, self, [load * factor for load in loads(self)])

    def with_orders(self, orders: Sequence[int], by_engine_order: bool) -> "Drive":
        """The same drive with harmonics of these orders; whether those that follow its engine order still do."""
        if self.harmonic is None:
            return self
        listed = tuple(
            _same_numbers(replace(one, order=n, by_engine_order=by_engine_order and one.by_engine_order), one)
            for one, n in zip(self.harmonic, orders, strict=True)
        )
        return eqx.tree_at(lambda drive: drive.harmonic, self, listed, is_leaf=lambda part: part is self.harmonic)

    def own_loads(self) -> Sequence[tuple[Any, ...]]:
        """The fields of the drive that are amplitudes of a force and of a moment, by harmonics."""
        if self._is_own:
            return [(one.F_0, one.M_0) for one in self.harmonics().values() if isinstance(one, DriveHarmonic)]
        if self.harmonic is None:
            return [(self.F_0, self.M_0)]
        return [one.amplitudes if isinstance(one, ComplexHarmonic) else (one.F, one.M) for one in self.harmonic]


def _same_numbers(one: Any, other: Any) -> Any:
    """A part of a scene with the numbers of another that is like it, as they are."""
    return jax.tree.unflatten(jax.tree.structure(one), jax.tree.leaves(other))
