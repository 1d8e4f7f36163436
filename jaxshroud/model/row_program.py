"""Programs of a row that are written for one element, in as few kernels as its exchanges allow.

A function of numbers of one blade, of one interface and of the lane is traced once, with scalars. Its operations belong
to blades or to interfaces; only an `exchange` leads from one to the other. Operations between the same exchanges become
one kernel over all blades, or over all interfaces, of all lanes. Each is done as late as its results allow, so that
kernels pass on few numbers, and once.
"""

from collections import defaultdict
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jax.extend.core import Literal as Constant

from jaxshroud.model.arithmetic import exchange, has_unrolled
from jaxshroud.model.row import Each, over

HOMES = ("lane", "blade", "interface")
EXCHANGES = len(HOMES)  # in the order of kernels, exchanges follow those of all places
# Of a kernel: the number of exchanges before it, the index of its place, and which part of these equations it has.
KernelKey = tuple[int, int, int]
MAX_INPUTS = 90  # of a kernel: with more numbers than some 120 it would lose vector registers
KernelSteps = list[Any]  # of a `jaxpr`


def of_row(each: Each, f: Callable[..., Any], lane: Any, blade: Any, interface: Any) -> Any:
    """`f(lane, blade, interface)` for a row: of an unrolled one as it stands, else in kernels.

    Args:
        each: How a function of one element is applied to a leading axis.
        f: A function of numbers of the lane, of one blade and of one interface; its results are such numbers.
        lane: A tree of arrays (lanes,).
        blade: A tree of arrays (blades, lanes), or (lanes,).
        interface: A tree of arrays (interfaces, lanes), or (lanes,).
    """
    trees = lane, blade, interface
    if has_unrolled(trees):
        return f(*trees)
    leaves, structure = jax.tree.flatten(trees)
    places = [at for at, own in zip(HOMES, trees, strict=True) for _ in jax.tree.leaves(own)]
    scalars = [jax.ShapeDtypeStruct((), a.dtype) for a in leaves]
    closed, out = jax.make_jaxpr(lambda *a: f(*structure.unflatten(a)), return_shape=True)(*scalars)
    program = closed.jaxpr
    values = dict(zip([*program.constvars, *program.invars], [*closed.consts, *leaves], strict=True))
    place = {v: at if a.ndim > 1 else "lane" for v, at, a in zip(program.invars, places, leaves, strict=True)}
    kernels = _kernels(program, place)
    wanted = _wanted(program, kernels)
    for key in sorted(kernels):
        equations = kernels[key]
        if key[1] == EXCHANGES:
            for eqn in equations:
                values[eqn.outvars[0]] = _moved(eqn, values)
        else:
            values |= _results_of_kernel(key, equations, wanted, values, each)
    return jax.tree.unflatten(jax.tree.structure(out), [_value(v, values) for v in program.outvars])


def _kernels(program: Any, place: dict[Any, str]) -> dict[KernelKey, KernelSteps]:
    """The equations of each kernel, by the number of exchanges before it and the index of its place.

    `place` has those of the arguments, and gets those of all results.
    """
    earliest = dict.fromkeys(place, 0)
    for eqn in program.eqns:
        inputs = _variables(eqn.invars, place)
        level = max((earliest[v] for v in inputs), default=0)
        at = max((place[v] for v in inputs), key=HOMES.index, default="lane")
        if eqn.primitive is exchange:
            level = level + 1
            at = eqn.params["to"]
        for v in eqn.outvars:
            earliest[v], place[v] = level, at
    latest = {v: earliest[v] for v in _variables(program.outvars, place)}
    kernels = defaultdict(list)
    for eqn in reversed(program.eqns):
        needed = [latest[v] for v in eqn.outvars if v in latest]
        if not needed:
            continue
        level = min(needed)
        moves = eqn.primitive is exchange
        before = level - 1 if moves else level
        for v in _variables(eqn.invars, place):
            latest[v] = min(latest.get(v, before), before)
        kernels[(before, EXCHANGES) if moves else (level, HOMES.index(place[eqn.outvars[0]]))].insert(0, eqn)
    parts = {key: [own] if key[1] == EXCHANGES else _parts(own) for key, own in kernels.items()}
    return {(*key, i): part for key, own in parts.items() for i, part in enumerate(own)}


def _parts(equations: KernelSteps) -> list[KernelSteps]:
    """The equations of a kernel in parts of at most `MAX_INPUTS` inputs each."""
    parts = [[]]
    inputs, made = set(), set()
    for eqn in equations:
        operands = {v for v in eqn.invars if not isinstance(v, Constant)}
        if len(inputs | (operands - made)) > MAX_INPUTS and parts[-1]:
            parts.append([])
            inputs, made = set(), set()
        parts[-1].append(eqn)
        inputs |= operands - made
        made |= set(eqn.outvars)
    return parts


def _wanted(program: Any, kernels: dict[KernelKey, KernelSteps]) -> dict[Any, set[Any]]:
    """The kernels that need each variable; the results of the program are needed outside."""
    wanted = defaultdict(set)
    for key, equations in kernels.items():
        for eqn in equations:
            for v in eqn.invars:
                if not isinstance(v, Constant):
                    wanted[v].add(key)
    for v in program.outvars:
        if not isinstance(v, Constant):
            wanted[v].add(None)
    return wanted


def _variables(operands: Any, among: Any) -> list[Any]:
    return [v for v in operands if not isinstance(v, Constant) and v in among]


def _value(v: Any, values: dict[Any, Any]) -> Any:
    return v.val if isinstance(v, Constant) else values[v]


def _moved(eqn: Any, values: dict[Any, Any]) -> Any:
    """The result of an exchange."""
    numbers = [jnp.asarray(_value(v, values)) for v in eqn.invars]
    shape = max((a.shape for a in numbers), key=len)
    return eqn.params["move"](*(jnp.broadcast_to(a, shape) for a in numbers))


def _results_of_kernel(
    key: KernelKey, equations: KernelSteps, wanted: dict[Any, set[Any]], values: dict[Any, Any], each: Each
) -> dict[Any, Any]:
    """The results of a kernel that are needed elsewhere."""
    inputs = list(dict.fromkeys(v for eqn in equations for v in _variables(eqn.invars, values)))
    outputs = [v for eqn in equations for v in eqn.outvars if wanted[v] - {key}]

    def kernel(*arrays):
        known = dict(zip(inputs, arrays, strict=True))
        for eqn in equations:
            numbers = [_value(v, known) for v in eqn.invars]
            results = eqn.primitive.bind(*numbers, **eqn.primitive.get_bind_params(eqn.params))
            known |= zip(eqn.outvars, results if eqn.primitive.multiple_results else [results], strict=True)
        return [known[v] for v in outputs]

    arrays = [values[v] for v in inputs]
    results = over(each, kernel, *arrays) if any(map(jnp.ndim, arrays)) else kernel(*arrays)
    return dict(zip(outputs, results, strict=True))
