"""The events of a march along loads that are applied slowly: rates are those by the share of the loads.

These jump where a stiffness does, while rates in time are continuous there. An event is therefore followed by a look at
the rates after it, which may end the state that it has led to at once.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxshroud.cache.programs import kept
from jaxshroud.linear.equilibrium import ContactState
from jaxshroud.linear.resting_contact import resting_state
from jaxshroud.march.event import Event
from jaxshroud.march.events import (
    events_at_points,
    guards_at,
    model_events,
    number_of,
    place_contact,
    transition,
)
from jaxshroud.model.arithmetic import filled, where
from jaxshroud.model.linear_system import coordinates_at
from jaxshroud.model.modes import FLAT, Mode
from jaxshroud.model.prepared import Model, State, prepared_model
from jaxshroud.model.rhs import EndTorques
from jaxshroud.model.row import pair_at
from jaxshroud.model.spring_contact import is_slipping
from jaxshroud.scene.scene import Scene

ROUNDINGS_CROSSED = 64  # roundings of the largest displacement, below which nothing is crossed
RATE_ROUNDING = 1e-9  # of the rate of the displacements, below which no slider is seen to turn back
TORQUE_ROUNDING = 1e-9  # of the torques at the ends of flat faces
LEAVES_LIMIT = 1e-7  # as `RATE_ROUNDING`: a guard on zero leaves it only faster than this


class PathEvents(NamedTuple):
    """The events at the interfaces of lanes, (lanes, interfaces, events); `after` has the points of each."""

    value: Any  # of the guards
    crossed: Any  # whether they are above zero by more than rounding
    reached: Any  # whether they are not below zero by more
    leaves: Any  # whether they are crossed, or are on zero and rise with the loads
    after: ContactState
    u_s: Any  # (lanes, interfaces, points) the sliders now; 0 where faces are apart


@kept()
def path_events(scenes: Scene, q: Any, rate: Any, contact: ContactState, torques: Any) -> PathEvents:
    """The events of scenes (leading axis) that are at rest under a share of their loads.

    Args:
        scenes: The scenes.
        q: The displacements (lanes, 3, blades).
        rate: Their derivatives by the share.
        contact: The state of contact.
        torques: Those at the lower and the upper end of flat faces, (lanes, interfaces, 2).
    """
    return jax.vmap(_events_of_lane)(scenes, q, rate, contact, torques)


def _events_of_lane(scene: Scene, q: Any, rate: Any, contact: ContactState, torques: Any) -> PathEvents:
    rounding = ROUNDINGS_CROSSED * jnp.finfo(q.dtype).eps * jnp.abs(q).max()
    fastest = jnp.abs(rate).max()

    def at_interface(j: Any, own: Any, contact: ContactState, torques: Any) -> PathEvents:
        model = prepared_model(pair_at(scene, j))
        held = State(None, contact.u_s, contact.mode, contact.case)
        state = resting_state(q.ravel()[own], held, model, rate.ravel()[own])
        return _events_at(contact, state, EndTorques(torques[0], torques[1]), model, rounding, fastest)

    places = coordinates_at(scene.layout)
    return jax.vmap(at_interface)(jnp.arange(len(places)), places, contact, torques)


def _events_at(
    contact: ContactState, state: State, torques: EndTorques, model: Model, rounding: Any, fastest: Any
) -> PathEvents:
    """The events at one interface, whose contact the `state` has as a march carries it, with rates by the share."""
    placed = place_contact(state.motion, state, model)
    view = guards_at(placed, torques, state, model)
    slips = {rub: is_slipping(contact.mode[m]) for m, (_, rub) in enumerate(events_at_points(model.law))}

    def of_points(a: Any) -> Any:
        each = a if isinstance(a, tuple) else (a,)
        return jnp.broadcast_to(jnp.stack(filled(each, rounding)), contact.mode.shape)

    def happening(event: Event) -> PathEvents:
        kind = number_of(event)
        value = view.guards.value[kind]
        least = where(slips.get(event, jnp.zeros((), bool)), RATE_ROUNDING * fastest, rounding)
        if event.switches_case:
            largest = jnp.maximum(*map(jnp.abs, torques))
            least = where(state.case == FLAT, TORQUE_ROUNDING * largest, least)
        after = transition(
            state=state,
            view=view,
            kind=jnp.int32(kind),
            delay=0 * rounding,
            soon=0 * rounding,
            model=model,
            rocks=jnp.ones((), bool),  # corners that turn past each other under load turn back
        ).after
        crossed = value > least
        reached = value >= -least
        return PathEvents(
            value=value,
            crossed=crossed,
            reached=reached,
            leaves=crossed | (reached & (view.guards.rate[kind] > LEAVES_LIMIT * fastest)),
            after=ContactState(of_points(after.mode), after.case, of_points(after.u_s)),
            u_s=0,
        )

    every = jax.tree.map(lambda *a: jnp.stack(a), *map(happening, model_events(model)))
    stretch = of_points(model.law.stretch_at(placed[2], state.u_s, state.mode))
    return every._replace(u_s=jnp.where(contact.mode == Mode.APART, 0.0, placed[2].u - stretch))
