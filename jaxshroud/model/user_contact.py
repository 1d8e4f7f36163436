"""A law of contact made of a normal law and a friction law, `Laws`, and the check that both are passive.

The internal state z of friction is integrated with the motion in place of the slider. Contact lasts while they push.
"""

import math
from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Float, PyTree

from jaxshroud.model.arithmetic import ZERO, Scalar, is_zero, where
from jaxshroud.model.contact_law import ContactLaw, ContactPoint, GuardCrossing, LawForces, Modes, Slider
from jaxshroud.model.geometry import AtPoint, RatesAtPoint
from jaxshroud.model.modes import Mode
from jaxshroud.scene.checks import InputError
from jaxshroud.scene.laws import FrictionLaw, NormalLaw
from jaxshroud.scene.scene import Scene
from jaxshroud.scene.typed import typed

CYCLE_POINTS = 4000  # of a cycle through which a law is taken
POWER_ROUNDING = 1e-9  # of the largest power, or energy, in a cycle
FREQUENCIES = (1.0, 100.0)  # of cycles of the penetration, over that of the drive
SLIDES = (1e-3, 1e-1, 1.0, 1e1, 1e3)  # of speeds of sliding, over that at which a block slides to and fro by the gap
Samples = Float[Array, " points"]


class _PartitionedFunction(eqx.Module):
    """A function whose arrays are leaves while everything else is static."""

    arrays: PyTree
    static: PyTree = eqx.field(static=True)

    def __init__(self, function: NormalLaw | FrictionLaw):
        self.arrays, self.static = eqx.partition(function, eqx.is_array)

    def __call__(self, *args: Any) -> Any:
        return eqx.combine(self.arrays, self.static)(*args)

    def check_shapes(self, name: str, args: tuple, names: str, shapes: list) -> None:
        """Raise InputError unless the function returns arrays of these shapes."""
        results = jax.eval_shape(self, *args)
        returned = [getattr(a, "shape", None) for a in results] if isinstance(results, tuple) else results
        if returned != shapes:
            raise InputError(f"The {name} law must return {names}, of shapes {shapes}, but returns {returned}.")


class Laws(ContactLaw):
    """A law of contact made of functions: a law of the normal force, and one of friction with its own internal state.

    `contact.k` and `friction.k_d` of the scene then state the largest stiffness of the two, on which the check of steps
    relies.

    Args:
        normal: `normal(v, v_t) -> (N, energy)`, see `NormalLaw`.
        friction: `friction(z, u_t, N) -> (F, z_t, energy)`, see `FrictionLaw`; None: no friction.
        z: The internal state of friction at each onset, of any shape; a scalar if the law has none.

    Raises:
        InputError: A law returns the wrong shapes.

    Example:
        >>> import jaxshroud as js
        >>> spring = js.Laws(lambda v, v_t: (1e6 * v, 5e5 * v**2))
        >>> spring.has_friction
        False
    """

    flows: ClassVar[bool] = True
    relaxes: ClassVar[bool] = True
    jumps_at_onset: ClassVar[bool] = True
    may_create_energy: ClassVar[bool] = True

    normal: _PartitionedFunction
    friction: _PartitionedFunction | None
    z: Array
    k: Scalar  # [N/m]; these two are absent until a model is prepared
    k_d: Scalar  # [N/m]

    @typed
    def __init__(self, normal: NormalLaw, friction: FrictionLaw | None = None, z: ArrayLike = 0.0):
        self.normal = _PartitionedFunction(normal)
        self.friction = None if friction is None else _PartitionedFunction(friction)
        self.z = jnp.asarray(z, float)
        self.k = ZERO
        self.k_d = ZERO
        number = jax.ShapeDtypeStruct((), self.z.dtype)
        self.normal.check_shapes("normal", (number, number), "(N, energy)", [(), ()])
        if self.friction is not None:
            self.friction.check_shapes("friction", (self.z, number, number), "(F, z_t, energy)", [(), self.z.shape, ()])

    def with_stiffnesses(self, k: Scalar, k_d: Scalar) -> "Laws":
        """The law with the largest stiffnesses that its user states for it [N/m]."""
        return eqx.tree_at(lambda law: (law.k, law.k_d), self, (k, k_d), is_leaf=is_zero)

    @property
    def has_friction(self) -> bool:
        """Whether there is a friction law."""
        return self.friction is not None

    @property
    def normal_stiffness(self) -> Scalar:
        """The stated stiffness of the normal law [N/m]."""
        return self.k

    @property
    def tangential_stiffness(self) -> Scalar:
        """The stated stiffness of the friction law [N/m]."""
        return self.k_d

    def relaxation(self, speed: Scalar) -> Scalar:
        """The fastest relaxation rate of z in unloaded faces [1/s]."""
        friction = self.friction
        if friction is None:
            return jnp.zeros_like(speed)
        z = jnp.asarray(self.z, speed.dtype)

        def rate(u_t: Scalar) -> Scalar:
            by_z = jax.jacfwd(lambda z: jnp.ravel(friction(z, u_t, jnp.zeros_like(u_t))[1]))(z)
            return jnp.max(jnp.sum(jnp.abs(by_z.reshape(z.size, z.size)), axis=-1))

        return jnp.maximum(rate(speed), rate(-speed))

    def forces(self, point: ContactPoint) -> LawForces:
        """The forces of the laws and the rate of z; a normal force cannot pull."""
        rate = point.rates()
        touches = point.mode != Mode.APART
        N = where(touches, jnp.maximum(self.normal(jnp.maximum(point.at.v, 0.0), rate.v)[0], 0.0), 0.0)
        if self.friction is None or is_zero(point.u_s):
            return LawForces(N, ZERO, ZERO)
        F, z_t, _ = self.friction(point.u_s, rate.u, N)
        return LawForces(N, where(touches, F, 0.0), where(touches, z_t, jnp.zeros_like(z_t)))

    def stretch(self, v: Scalar, u: Scalar, u_s: Slider, mode: Modes) -> Slider:
        """The state z."""
        del v, u, mode
        return u_s

    def stored_energy(self, v: Scalar, w: Slider, mode: Modes) -> Scalar:
        """The energy stored in the laws [J]."""
        return where(mode == Mode.APART, 0.0, self._energy(jnp.maximum(v, 0.0), w))

    def _energy(self, v: Scalar, z: Slider = ZERO) -> Scalar:
        """The energy [J] stored at a penetration of at least 0 and an internal state."""
        zero = jnp.zeros_like(v)
        stored = self.normal(v, zero)[1]
        return stored if self.friction is None else stored + self.friction(z, zero, zero)[2]

    def dissipated_power(self, point: ContactPoint, forces: LawForces) -> Scalar:
        """What the laws do not store of the power that they get [W]."""
        rate = point.rates()
        v = jnp.maximum(point.at.v, 0.0)
        v_t = where(point.at.v > 0, rate.v, 0.0)
        numbers = 1 if self.friction is None else 2
        stored = jax.jvp(self._energy, (v, point.u_s)[:numbers], (v_t, forces.u_s)[:numbers])[1]
        return where(point.mode == Mode.APART, 0.0, forces.N * rate.v + forces.F * rate.u - stored)

    def carried_slider(self, u_s: Slider, mode: Modes) -> Slider:
        """The state z, by default the first one; absent without a friction law."""
        if self.friction is None:
            return ZERO
        return jnp.where(mode == Mode.APART, self.z, u_s) if jnp.shape(u_s) == self.z.shape else self.z

    def lift_guard(self, at: AtPoint, rate: RatesAtPoint, apart: Bool[Array, ""]) -> tuple[Scalar, Scalar]:
        """That of `ContactLaw`; in contact the normal law must push as well."""
        push = self.normal(jnp.maximum(at.v, 0.0), rate.v)[0] / self.k  # a length, as v is
        sign = where((at.v > 0) & (push <= 0), -1.0, 1.0)  # apart although the corners overlap
        in_contact = -jnp.minimum(at.v, push), where(push < at.v, 0.0, -rate.v)
        return where(apart, sign * at.v, in_contact[0]), where(apart, sign * rate.v, in_contact[1])

    def slider_after(self, crossing: GuardCrossing, w: Slider, mode: Modes, u: Scalar) -> Slider:
        """The state z goes on while contact lasts, and is the first one at an onset."""
        del w, u
        if is_zero(crossing.u_s):
            return ZERO
        in_contact = (crossing.mode != Mode.APART) & (mode != Mode.APART)
        return where(in_contact, crossing.u_s, self.z)


class LawCycle(NamedTuple):
    """What one law does in a cycle; the speed is that of approach, or of sliding."""

    load: Samples  # penetration [m], or N [N]
    speed: Samples  # [m/s]
    force: Samples  # [N]
    energy: Samples  # stored [J]
    spare: Samples  # its spurious dependence on the speed or on N
    loss: Samples  # power dissipated [W]


class LawInWords(NamedTuple):
    """The words in which the faults of a law are described."""

    name: str
    nothing: str
    depends_on: str
    load: str


NORMAL = LawInWords(name="normal", nothing="v = 0", depends_on="v", load="v = {:.3g} m")
FRICTION = LawInWords(name="friction", nothing="the first z", depends_on="z", load="N = {:.3g} N")


@typed
def check_laws(scene: Scene) -> None:
    """Take the `Laws` of a scene through cycles of loading and sliding, and refuse laws that are not passive.

    Each law is tested alone. The penetration rises from 0 to the gap's size and falls back, within a period of the
    drive and within a hundredth of one. For friction it is N that rises from 0 to the largest normal force of these
    cycles and falls back, within a period of the drive, while the blocks slide to and fro at speeds from a thousandth
    to a thousand times that at which they would move by the gap.

    Args:
        scene: A scene `with_contact_law`, of `Laws`.

    Raises:
        InputError: The scene has no such laws; or one of them, which is named, is not finite, stores energy where
            nothing is pressed or bent, stores energy that depends on more than v or z, or returns more work than it has
            received.

    Example:
        >>> import jax; jax.config.update("jax_enable_x64", True)
        >>> import jaxshroud as js
        >>> scene = js.load("table1").scene
        >>> js.check_laws(js.with_contact_law(scene, js.Laws(js.Hertz(4e7))))
        >>> giving = js.Laws(lambda v, v_t: (1e6 * v - 10 * v_t, 5e5 * v**2))
        >>> js.check_laws(js.with_contact_law(scene, giving))
        Traceback (most recent call last):
        ...
        jaxshroud.scene.checks.InputError: The normal law gives out more work than it gets (v = 1.1e-05 m, -0.0059 m/s).
    """
    laws = scene.laws
    if not isinstance(laws, Laws):
        raise InputError("This scene has no js.Laws, which `check_laws` takes; see js.with_contact_law.")
    size = jnp.max(jnp.abs(scene.running_shroud.gap)) + 1e-9
    omega = scene.drive.omega
    largest = jnp.zeros_like(omega)
    for frequency in FREQUENCIES:
        cycle = _normal_cycle(laws, size, frequency * omega)
        _check_passive(NORMAL, cycle)
        largest = jnp.maximum(largest, jnp.max(cycle.force))
    if laws.friction is None:
        return
    for slide in SLIDES:
        _check_passive(FRICTION, _friction_cycle(laws, largest, omega, slide * 2 * size * omega))


def _check_passive(law: LawInWords, cycle: LawCycle) -> None:
    """Raise InputError unless the law is finite and passive; the cycle begins where nothing is pressed or bent."""
    values = jax.tree.map(np.asarray, cycle)
    finite = np.asarray(np.isfinite([values.force, values.energy, values.loss]).all(axis=0))
    what = f"The {law.name} law"

    def place(faults: np.ndarray) -> str:
        at = int(faults.argmax())
        return f"({law.load.format(values.load[at])}, {values.speed[at]:.3g} m/s)"

    if not finite.all():
        raise InputError(f"{what} is not finite {place(~finite)}; mind quotients by what is 0 where contact begins.")
    gained = -values.loss - POWER_ROUNDING * np.max(np.abs(values.force * values.speed))
    if np.any(gained > 0):
        raise InputError(f"{what} gives out more work than it gets {place(gained == gained.max())}.")
    energies = POWER_ROUNDING * max(float(np.max(np.abs(values.energy))), 1e-30)
    if abs(float(values.energy[0])) > energies:
        raise InputError(f"{what} stores energy where nothing is pressed yet: that of {law.nothing} must be 0.")
    if np.any(np.abs(values.spare) > energies):
        raise InputError(f"The energy of the {law.name} law must depend on nothing but {law.depends_on}.")


@jax.jit
def _normal_cycle(laws: Laws, size: Float[Array, ""], omega: Float[Array, ""]) -> LawCycle:
    """The normal law while the penetration rises to `size` and falls back once, at an angular frequency."""

    def values(tau) -> LawCycle:
        v, v_t = size * (1 - jnp.cos(tau)) / 2, size * omega * jnp.sin(tau) / 2
        N, stored = laws.normal(v, v_t)
        N = jnp.maximum(N, 0.0)
        plain, power = jax.jvp(lambda v: laws.normal(v, jnp.zeros_like(v))[1], (v,), (v_t,))
        return LawCycle(load=v, speed=v_t, force=N, energy=plain, spare=stored - plain, loss=N * v_t - power)

    return jax.vmap(values)(_cycle_angles(omega))


@jax.jit
def _friction_cycle(laws: Laws, largest: Float[Array, ""], omega: Float[Array, ""], fastest) -> LawCycle:
    """The friction law while N rises to `largest` and falls back once, and the blocks slide to and fro twice.

    z follows by the linearly implicit Euler method, which stays finite where z is quick.
    """
    friction, z_shape = laws.friction, laws.z.shape
    assert friction is not None
    h = 2 * math.pi / CYCLE_POINTS / omega

    def motion(tau):
        return fastest * jnp.cos(2 * tau), largest * (1 - jnp.cos(tau)) / 2

    def step(z, tau):
        def rate(flat):
            return jnp.ravel(friction(flat.reshape(z_shape), *motion(tau))[1])

        flat = jnp.ravel(z)
        system = jnp.eye(flat.size, dtype=flat.dtype) - h * jax.jacfwd(rate)(flat)
        z = (flat + jnp.linalg.solve(system, h * rate(flat))).reshape(z_shape)
        return z, z

    def values(tau, z) -> LawCycle:
        u_t, N = motion(tau)
        F, z_t, stored = friction(z, u_t, N)
        none = jnp.zeros_like(N)
        plain, power = jax.jvp(lambda z: friction(z, none, none)[2], (z,), (z_t,))
        return LawCycle(load=N, speed=u_t, force=F, energy=plain, spare=stored - plain, loss=F * u_t - power)

    taus = _cycle_angles(omega)
    _, states = jax.lax.scan(step, laws.z, taus[1:])
    return jax.vmap(values)(taus, jnp.concatenate([laws.z[None], states]))


def _cycle_angles(omega: Float[Array, ""]) -> Samples:
    return jnp.arange(CYCLE_POINTS, dtype=omega.dtype) * (2 * math.pi / CYCLE_POINTS)
