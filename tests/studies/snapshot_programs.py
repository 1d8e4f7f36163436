"""Marches for the study `snapshots`: the programs of pairs and of rows as XLA receives them, lowered, not compiled.

Pure functions are lowered as they are. Verbs run until they want a march compiled, which ends them: they have to keep
programs, of which those that are found are not lowered again. Tangents of a row are wanted only after a march, so that
`row_tangents` alone names modules of the package, and follows where these go.

Names do not count: functions of a program are numbered, and what says where a number comes from is left out.
"""

import re
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import partial
from hashlib import sha256
from tempfile import TemporaryDirectory
from typing import Any
from unittest.mock import patch

import jax
import jax.numpy as jnp
import numpy as np

import jaxshroud as js
from jaxshroud.cache.programs import keep_programs
from jaxshroud.model.linear import free_power

GAP, OMEGA = 22e-6, 536.0  # [m], [rad/s]
STEPS = 400
RK4 = js.RungeKutta("rk4", STEPS)
DOPRI8 = js.RungeKutta("dopri8", STEPS, "bisection")
TSIT5 = js.RungeKutta("tsit5", STEPS)  # of verbs: no command that comes before has compiled it
SINGLE = js.RungeKutta("rk4", STEPS, precision="float32")
SERIES = js.Taylor(steps=STEPS)
X, XY = 'parts.motion=["x"]', 'parts.motion=["x", "y"]'
FREE, SMOOTH = "parts.contact=none", ("parts.contact=smooth", "contact.width=50 um")
LANES = 3
LOOP = "stablehlo.while"
Entry = dict[str, Any]
SYMBOL = re.compile(r'@(?:"[^"]*"|[\w.$-]+)')
OPERATION = re.compile(r"\b((?:stablehlo|chlo|func|sdy|mhlo)\.\w+)")
NAMES = (  # what only tells of names and places
    (re.compile(r"\s*loc\((?:[^()]|\([^()]*\))*\)"), ""),
    (re.compile(r"^#loc.*\n", re.MULTILINE), ""),
    (re.compile(r'jax\.(?:arg|result)_info = "(?:[^"\\]|\\.)*"(?:, )?'), ""),
    (re.compile(r" \{\}"), ""),
)


def programs() -> dict[str, Callable[[], Entry]]:
    """The entries of programs, by their names."""
    marches = {**of_pairs(), **of_pairs_with_tangents(), **of_lanes(), **of_rows()}
    pure = {f"lowered/{name}": lambda make=make: lowered(*make()) for name, make in marches.items()}
    return pure | {f"lowered/{name}": lambda verb=verb: first_march(verb) for name, verb in of_verbs().items()}


def lowered(function: Callable, *arguments: Any) -> Entry:
    """What is stored of a program: a hash, and how many operations it has in all and by their names."""
    return described(jax.jit(function).lower(*arguments))


def described(program: jax.stages.Lowered) -> Entry:
    """The same of a program that is lowered."""
    text = without_names(program.as_text())
    counts = Counter(OPERATION.findall(text))
    return {
        "sha256": sha256(text.encode()).hexdigest(),
        "operations": counts.total(),
        "by name": dict(sorted(counts.items())),
    }


def without_names(text: str) -> str:
    """The text of a program with its functions numbered, and without where its numbers come from."""
    for pattern, word in NAMES:
        text = pattern.sub(word, text)
    numbers: dict[str, str] = {}
    return SYMBOL.sub(lambda found: numbers.setdefault(found[0], f"@f{len(numbers)}"), text)


# What is lowered: a function and its arguments


def pair(*changes: str) -> js.Scene:
    """Two blades."""
    return js.load("table1", list(changes)).scene


def row(*changes: str) -> js.Scene:
    """A chain of three blades."""
    return js.load("row_ring12", ["row.blades=3", "row.closed=false", "drive.engine_order=1", *changes]).scene


def of_pairs() -> dict[str, Callable[[], tuple[Any, ...]]]:
    """Whole periods and samples of pairs."""
    return {
        "pair, rk4": lambda: mapped(pair(), RK4),
        "pair, x alone, rk4": lambda: mapped(pair(X), RK4),
        "pair, rk4, float32": lambda: mapped(pair(), SINGLE),
        "pair, dopri8, bisection": lambda: mapped(pair(), DOPRI8),
        "pair, series": lambda: mapped(pair(), SERIES),
        "pair without contact, rk4": lambda: mapped(pair(FREE), RK4),
        "pair with smooth contact, rk4": lambda: mapped(pair(*SMOOTH), RK4),
        "pair, rk4, rollout": lambda: rolled(pair(), RK4),
    }


def of_pairs_with_tangents() -> dict[str, Callable[[], tuple[Any, ...]]]:
    """The same with the tangent of the gap, and in reverse mode."""
    return {
        "pair, rk4, tangent": lambda: pushed(*mapped(pair(), RK4)),
        "pair, series, tangent": lambda: pushed(*mapped(pair(), SERIES)),
        "pair without contact, rk4, tangent": lambda: pushed(*mapped(pair(FREE), RK4)),
        "pair with smooth contact, rk4, tangent": lambda: pushed(*mapped(pair(*SMOOTH), RK4)),
        "pair, rk4, rollout, gradient": lambda: pulled(*rolled(pair(), RK4)),
    }


def of_lanes() -> dict[str, Callable[[], tuple[Any, ...]]]:
    """Sweeps of many lanes, and what their power is compared with."""
    return {
        "lanes of pairs, rk4": lambda: swept(pair(), RK4),
        "lanes of pairs, series": lambda: swept(pair(X), SERIES),
        "lanes of pairs, rk4, tangent": lambda: pushed(*swept(pair(), RK4)),
        "lanes of rows, rk4": lambda: swept(row(), RK4),
        "power without contact, pair": lambda: (lambda omega: free_power(driven(pair(), omega)), OMEGA),
        "power without contact, row": lambda: (lambda omega: free_power(driven(row(), omega)), OMEGA),
    }


def of_rows() -> dict[str, Callable[[], tuple[Any, ...]]]:
    """Rows of blades."""
    return {
        "row, rk4": lambda: rolled(row(), RK4),
        "row, x alone, dopri8, bisection": lambda: rolled(row(X), DOPRI8),
        "row with smooth contact, rk4": lambda: rolled(row(*SMOOTH), RK4),
        "row, rk4, tangent": lambda: row_tangents(row(), RK4),
        "row, x alone, rk4, tangent": lambda: row_tangents(row(X), RK4),
    }


def of_verbs() -> dict[str, Callable[[], Any]]:
    """Marches of verbs. Without contact each has a model of its own, so that none finds what another has compiled."""
    simulated = dict(n_periods=2, every=5)
    alone, all_kept = dict(n_periods=2, transient=1), dict(ledger=True, forces=True, amplitudes=True)
    gaps = {"shroud.gap": np.linspace(GAP, 2 * GAP, LANES)}
    return {
        "simulate pair": lambda: js.simulate(pair(), method=TSIT5, **simulated),
        "simulate pair, series": lambda: js.simulate(pair(X), method=SERIES, **simulated),
        "simulate pair without contact": lambda: js.simulate(pair(FREE, X), method=TSIT5, **simulated),
        "simulate row": lambda: js.simulate(row(), method=TSIT5, **simulated),
        "sweep pair": lambda: js.sweep(pair(), gaps, method=TSIT5, **alone),
        "sweep pair, all kept": lambda: js.sweep(pair(), gaps, method=TSIT5, **alone, **all_kept),
        "sweep pair without contact": lambda: js.sweep(pair(FREE, XY), gaps, method=TSIT5, **alone),
        "sweep row": lambda: js.sweep(row(), gaps, method=TSIT5, **alone),
    }


def with_gap(scene: js.Scene, gap: Any) -> js.Scene:
    """A scene with another gap, of all interfaces."""
    return js.vary(scene, "shroud.gap", gap)


def driven(scene: js.Scene, omega: Any) -> js.Scene:
    """A scene with another frequency of the drive."""
    return js.vary(scene, "drive.omega", omega)


def mapped(scene: js.Scene, how: Any) -> tuple[Any, ...]:
    """A period of a pair, by its gap."""
    state = js.State(scene.initial, np.zeros(()), np.int32(0), np.int32(0))
    return lambda gap: js.period_map(with_gap(scene, gap), state, method=how), GAP


def rolled(scene: js.Scene, how: Any) -> tuple[Any, ...]:
    """Samples of a motion, by the gap."""
    return lambda gap: js.rollout(with_gap(scene, gap), n_periods=2, every=STEPS // 2, method=how), GAP


def swept(scene: js.Scene, how: Any) -> tuple[Any, ...]:
    """Lanes with gaps of their own."""
    run = js.sweep_function(n_periods=2, transient=1, method=how)
    return lambda gaps: run(jax.vmap(partial(with_gap, scene))(gaps)), np.linspace(GAP, 2 * GAP, LANES)


def pushed(function: Callable, at: Any) -> tuple[Any, ...]:
    """A function with its tangent."""
    return lambda at: jax.jvp(function, (at,), (jnp.ones_like(at),)), at


def pulled(function: Callable, at: Any) -> tuple[Any, ...]:
    """The power of a rollout with its derivative in reverse mode."""
    return jax.value_and_grad(lambda at: function(at).power.sum()), at


# What has no pure function


class Wanted(BaseException):
    """A march is to be compiled."""


def first_march(verb: Callable[[], Any]) -> Entry:
    """The first program with a loop that a verb wants compiled, which ends the verb; without any, the largest."""
    found, compiled = [], jax.stages.Lowered.compile

    def compile_others(program: jax.stages.Lowered, *arguments: Any, **options: Any) -> Any:
        found.append(described(program))
        if LOOP in found[-1]["by name"]:
            raise Wanted
        return compiled(program, *arguments, **options)

    with programs_kept(), patch.object(jax.stages.Lowered, "compile", compile_others), suppress(Wanted):
        verb()
    assert found, "no program was lowered: was the package changed meanwhile, or is there an earlier program?"
    return found[-1] if LOOP in found[-1]["by name"] else max(found, key=lambda entry: entry["operations"])


@contextmanager
def programs_kept() -> Iterator[None]:
    """Within, programs are kept in a folder that goes again; later they are kept nowhere until a command says so."""
    before = jax.config.jax_compilation_cache_dir  # type: ignore[attr-defined]
    try:
        with TemporaryDirectory() as folder:
            js.cache_compilations(folder)
            yield
    finally:
        keep_programs(None)
        jax.config.update("jax_compilation_cache_dir", before)


def row_tangents(scene: js.Scene, how: Any) -> tuple[Any, ...]:
    """A period of a row with the tangents that Newton's method and gradients take."""
    from jaxshroud.batch.flows import as_differentiable, begin_flows, end_flows, flow_with_tangents
    from jaxshroud.batch.lanes import initial_states
    from jaxshroud.batch.periods import one_call
    from jaxshroud.batch.tangents import TangentProblem, direction
    from jaxshroud.batch.xla import best_mapping
    from jaxshroud.march.method import choices

    start = jax.tree.map(lambda a: a[0], initial_states(lanes_of(scene)))
    duals = TangentProblem(scene, start, [direction(scene, "contact.gamma")]).duals
    method = as_differentiable(choices(how))

    def flow(scenes: Any, states: Any) -> Any:
        begin = begin_flows(scenes, states, method)
        how = jnp.int32(STEPS), jnp.asarray(method.flat_return), None, method, best_mapping()
        end, _ = flow_with_tangents(scenes, begin, one_call(1), *how)
        return end_flows(scenes, end, jnp.int32(1), None)

    return flow, *duals


def lanes_of(scene: js.Scene) -> js.Scene:
    """Equal lanes of a scene."""
    return jax.tree.map(lambda a: np.repeat(np.asarray(a)[None], LANES, axis=0), scene)
