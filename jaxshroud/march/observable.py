"""What an observable is: a quantity that is logged along a march, of every interface or of every blade.

The built-in ones stand in `logged`; `Choices.observables` has a user's own. `log` keeps their values through trials.
"""

from collections.abc import Callable
from typing import Any, Literal, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Int

from jaxshroud.march.events import Transition
from jaxshroud.model.arithmetic import Scalar
from jaxshroud.model.contact_law import ContactLoads
from jaxshroud.model.prepared import Model
from jaxshroud.scene.keys import Motion


class Beginning(NamedTuple):
    """The start of a march, at one interface or of one blade."""

    motion: Any  # of the blade; None of an interface
    zero: Scalar  # of the type of real numbers
    v: Scalar  # penetration where there is contact, else 0 [m]; of blades 0
    model: Model | None  # of the interface; None of a blade


class Lift(NamedTuple):
    """Whether contact begins or ends at an interface."""

    onset: Bool[Array, ""]
    impact: Bool[Array, ""]  # an onset from a gap
    separation: Bool[Array, ""]


class Ending(NamedTuple):
    """How a trial ended at an interface."""

    transition: Transition
    fire: Bool[Array, ""]  # it ended in this transition
    inside: Bool[Array, ""]  # at a maximum of the guard within a step


class InterfaceTrial(NamedTuple):
    """A trial that was accepted, at one interface."""

    h: Scalar  # its length [s]
    mode: Int[Array, ""]  # during it; of smooth contact, whether the blades touch at its end
    v: Any  # penetration at its end, by power series the largest within [m]
    apart: Any = None  # whether the blades are apart in that mode
    start: Any = None  # `State` of both blades and their contact; rows give it to observables that take "one" alone,
    end: Any = None  # as the `Motion` of both blades at its end, before what happens there,
    lift: Any = None  # the `Lift` there,
    loads: ContactLoads | None = None  # the loads of the trial, if the method integrates them,
    model: Any = None  # and the `Model` of the pair
    by_series: Any = None  # `Observable.of_series` of the trial; None for Runge-Kutta methods


class BladeTrial(NamedTuple):
    """A trial that was accepted, of one blade."""

    start: Motion
    end: Motion  # at its end, before what happens there
    after: Motion  # with which a row goes on, once blocks with flat faces turn as one; of pairs the same as `end`
    h: Scalar  # its length [s]
    step: Int[Array, ""]  # in which it was made
    next_step: Int[Array, ""]  # in which the next one is made
    by_series: Any = None  # `Observable.of_series` of the trial; None for Runge-Kutta methods

    @property
    def complete(self) -> Bool[Array, "..."]:
        """Whether a step ends with the trial."""
        return self.next_step > self.step


Per = Literal["interface", "blade", "left blade"]


class Observable(NamedTuple):
    """A quantity that is logged along a march.

    Its functions are traced by JAX. They are those of one interface or of one blade: a march applies them to all of
    them. A value is a number, or a NamedTuple of numbers.
    """

    name: str
    label: str
    unit: str
    per: Per
    """The interface, the blade, or of pairs the left blade alone, of rows every blade."""
    start: Callable[[Beginning], Any]
    """The value before the first trial."""
    update: Callable[[Any, Any], Any]
    """The value after a trial, from that before it and an `InterfaceTrial`, a `BladeTrial`, or an `Ending`."""
    reset: Callable[[Any, Motion], Any]
    """The value at the start of a drive period, from that before and the motion there; `lasting` and `from_zero`."""
    of_series: Callable[[Any], Any] | None = None
    """What an update by power series reads off the polynomials of a trial, a `ContactSeries` or a `MotionSeries`."""
    takes: Literal["one", "event", "all"] = "one"
    """What an update takes: the trial at one interface or of one blade; the `Ending` at one interface, where there are
    events; or all interfaces or blades at once, as it is arithmetic of trees of arrays, which saves rows a kernel."""
    recorded: Callable[[Any], bool] = lambda method: True
    """Whether it is logged with a method, from its `Choices`."""


def lasting(value: Any, _: Motion) -> Any:
    """A `reset` of values of a whole run: the value goes on."""
    return value


def from_zero(value: Any, _: Motion) -> Any:
    """A `reset` of values of single periods: the value starts from zero."""
    return jax.tree.map(jnp.zeros_like, value)
