"""The derivative of an event's instant.

Searching for a root gives its value but no derivative: the instant enters through comparisons only, and differentiating
through them is silently wrong wherever the forces differ before and after. The implicit function theorem has it: where
a guard g(t, p) vanishes, dt/dp = -(dg/dp) / (dg/dt).
"""

import jax


@jax.custom_jvp
def at_the_root(quantities, slopes, guard, rate):
    """`quantities` at the instant when `guard` vanishes.

    As numbers they are taken as given, at an instant that has been found; their derivatives are those of quantities
    that move with their `slopes` until the root that moves too.

    Args:
        quantities: Any tree of numbers at the given instant.
        slopes: Their time derivatives.
        guard: Value of the guard there.
        rate: Its time derivative; infinite where the instant is given and not a root.
    """
    del slopes, guard, rate
    return quantities


@at_the_root.defjvp
def _at_the_root(primals, tangents):
    quantities, slopes, _, rate = primals
    shift = -tangents[2] / rate
    return quantities, jax.tree.map(lambda d, slope: d + slope * shift, tangents[0], slopes)
