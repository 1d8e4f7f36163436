"""Reference runs for the study `unchanged`: all verbs, all methods and models; every argument that matters is given.

A run gives arrays. A row of real numbers holds values of one quantity, that are compared relative to the largest of
them; a second array "... size" tells that size where the row does not. "... interval" holds values above half widths.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cache
from importlib import import_module
from itertools import product
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

import jaxshroud as js
from jaxshroud.march.method import Method
from jaxshroud.model.linear import free_power
from jaxshroud.verbs.gradient import differences

Values = dict[str, np.ndarray]
COUNTERS = (
    *("onset_slip", "onset_stick", "separation", "stick_slip", "slip_stick", "switch_14", "switch_23"),
    *("switch_12", "switch_34", "flat", "flat_corner", "grazing"),
)
TABLEAUS = {"rk4": 400, "tsit5": 400, "dopri8": 160}  # name -> steps per period
METHODS = tuple(product(TABLEAUS, ("cubic", "bisection"), ("float64", "float32")))
PLAIN = ("rk4", "cubic", "float64")
FULL = {
    "gamma 2.5": ("table1", "contact.gamma=2.5"),
    "gamma 6.5, M_0 1": ("table1", "contact.gamma=6.5", "drive.M_0=1"),
    "light, M_0 0.5": ("table1_light", "drive.M_0=0.5"),
    "interference": ("table1", "contact.gamma=4", "shroud.gap=-0.01 mm"),
}
MODELS = {
    "x": ('parts.motion=["x"]',),
    "x, y": ('parts.motion=["x", "y"]',),
    "rigid neighbour": ("parts.neighbour=rigid",),
    "no friction": ("parts.friction=none",),
    "no contact": ("parts.contact=none",),
    "smooth contact": ("parts.contact=smooth", "contact.width=50 um"),
    "x, rigid, no friction": ('parts.motion=["x"]', "parts.neighbour=rigid", "parts.friction=none"),
    "printed": ("contact.reading=printed",),
    "two misprints": ('contact.reading=["gap_sign", "levers"]',),
    "m_y": ("blades.m_y=0.1",),
}
CHAOTIC = {"gamma 5.5": (5.5, 100.0), "gamma 6.5, M_0 1": (6.5, 1.0), "gamma 7.5, M_0 0.2": (7.5, 0.2)}
MAPS = (
    PLAIN,
    ("rk4", "bisection", "float64"),
    ("dopri8", "cubic", "float64"),
    ("rk4", "cubic", "float32"),
    ("tsit5", "cubic", "float32"),
)
SAMPLED = 4  # places in a period where the sizes of quantities are taken


class Given(NamedTuple):
    """What all runs have in common."""

    starts: Mapping[str, np.ndarray]  # states on attractors
    moved: float = 0.0  # relative, of the bending stiffness along x: what that changes must be told

    def scene(self, source: str, *overrides: str) -> js.Scene:
        """A shipped scene with changes."""
        scene = js.load(source, list(overrides)).scene
        return js.vary(scene, "blades.k_x", scene.blades.k_x * (1 + self.moved))


class Run(NamedTuple):
    """One run, and the rule that it is held to."""

    group: str
    name: str
    rule: str
    does: Callable[[Given], Values]
    precision: str = "float64"

    @property
    def path(self) -> str:
        """Where its values are stored."""
        return f"{self.group}/{self.name}"

    def values(self, given: Given) -> Values:
        """What it gives; if it raises, what."""
        try:
            return self.does(given)
        except Exception as error:
            return {"raised": text(type(error).__name__), "message free": text(str(error))}


def method(name: str, locate: str, precision: str) -> js.RungeKutta:
    """How to march, but for the steps."""
    return js.RungeKutta(name, locate=locate, precision=precision)  # type: ignore[arg-type]


def rows(*quantities: Any) -> np.ndarray:
    """One row for each quantity."""
    return np.stack([np.ravel(np.asarray(a)) for a in quantities])


def text(words: str) -> np.ndarray:
    """Words as whole numbers."""
    return np.frombuffer(words.encode(), np.uint8)


def counted(counters: Mapping[str, Any]) -> np.ndarray:
    """Numbers of events."""
    return np.stack([np.asarray(counters[name]) for name in COUNTERS])


# One scene


def simulated(scene: js.Scene, how: Method, n_periods: int, steps: int | str, state: js.State | None = None):
    """A trajectory with few samples."""
    every = steps // SAMPLED if isinstance(steps, int) else 1
    return js.simulate(
        scene, state, n_periods=n_periods, method=how.replace(steps=steps), every=every, turns=0.0, t=0.0
    )


def trajectory(scene: js.Scene, how: Method, n_periods: int, steps: int) -> Values:
    """What `simulate` gives."""
    came = simulated(scene, how, n_periods, steps)
    energies = np.array([[came.energy_residual, came.energy_dropped]])
    return {
        "motion": rows(*came.motion),
        "slider": rows(came.u_s, came.motion.x[:, 0]),
        "contact": np.stack([came.mode, came.case]),
        "status": np.asarray(came.status),
        "events": counted(came.counters),
        "chatter": np.asarray(came.chatter is not None),
        "energy absolute": energies,
        "time": rows(came.t, came.turns * np.ones_like(came.t)),
    }


def simulations() -> Iterator[Run]:
    """All methods on the full model."""
    for how, (name, scene) in product(METHODS, FULL.items()):

        def does(given: Given, how=how, scene=scene) -> Values:
            return trajectory(given.scene(*scene), method(*how), 2, TABLEAUS[how[0]])

        yield Run("simulate", f"{', '.join(how)}, {name}", "few periods", does, how[2])


def models() -> Iterator[Run]:
    """Models made of other parts."""
    for (name, parts), (gamma, F_0) in product(MODELS.items(), ((2.5, 60), (4.2, 30), (7.0, 60))):

        def does(given: Given, parts=parts, gamma=gamma, F_0=F_0) -> Values:
            scene = given.scene("table1", f"contact.gamma={gamma}", f"drive.F_0={F_0}", *parts)
            return trajectory(scene, method(*PLAIN), 2, 800)

        yield Run("models", f"{name}, gamma {gamma}", "few periods", does)


def shipped() -> Iterator[Run]:
    """All shipped scenes."""
    for name in js.shipped():
        if name.endswith(("_best", "_points")) or name.startswith(("row_", "fem_")):
            continue  # these are newer than what is stored

        def does(given: Given, name=name) -> Values:
            return trajectory(given.scene(name), method("tsit5", "cubic", "float64"), 2, 400)

        yield Run("shipped", name, "few periods", does)


def stopped() -> Iterator[Run]:
    """Runs that do not end well."""
    cases = {"turned too far": ("drive.M_0=1e4",), "stiff": ("contact.gamma=20",)}
    for name, overrides in cases.items():

        def does(given: Given, overrides=overrides) -> Values:
            return trajectory(given.scene("table1", *overrides), method("rk4", "bisection", "float64"), 2, 400)

        yield Run("stopped", name, "few periods", does)


# Sweeps


def swept(
    scene: js.Scene,
    along: Mapping[str, Any],
    how: Method,
    *,
    n_periods: int,
    transient: int,
    steps: int | str = 400,
    direction: str = "independent",
    phase: float = 0.0,
    period_tol: float = 1e-3,
    ledger: bool = False,
) -> js.SweepResult:
    """`sweep` with all its arguments."""
    return js.sweep(
        scene,
        along,
        n_periods=n_periods,
        transient=transient,
        method=how.replace(steps=steps),  # type: ignore[arg-type]
        direction=direction,  # type: ignore[arg-type]
        phase=phase,
        period_tol=period_tol,
        ledger=ledger,
    )


def diagram(came: js.SweepResult) -> Values:
    """What `sweep` gives of lanes from their starts."""
    none = np.full(came.status.shape, np.nan)
    energies = [none if a is None else a for a in (came.energy_residual, came.energy_dropped)]
    return {
        "motion": rows(*(a[..., -1, :] for a in came.motion)),
        "power": rows(came.P, came.P_0),
        "P_d of few periods": rows(came.P_d),
        "period number": came.period_number,
        "status": came.status,
        "settling": np.stack([came.settling, came.P_d_settling]),
        "events": counted(came.counters),
        "times": rows(came.time_apart, came.time_stick, came.time_slip),
        "v_max": rows(came.v_max),
        "energy absolute": rows(*energies),
        "steps": np.asarray(came.steps_per_period),
    }


def sweeps() -> Iterator[Run]:
    """Several methods, one axis; ledger on where events are located by bisection."""
    located = [(name, "cubic", "float64") for name in TABLEAUS]
    for how in (*located, ("rk4", "bisection", "float64"), ("rk4", "cubic", "float32"), ("dopri8", "cubic", "float32")):

        def does(given: Given, how=how) -> Values:
            scene, ledger = given.scene("table1", "drive.F_0=60"), how[1] == "bisection"
            along = {"contact.gamma": [0.3, 1.5, 2.5, 4.2, 6.0, 7.5]}
            steps = TABLEAUS[how[0]]
            return diagram(swept(scene, along, method(*how), n_periods=3, transient=1, steps=steps, ledger=ledger))

        yield Run("sweep, methods", ", ".join(how), "few periods", does, how[2])


AXES: dict[str, tuple[dict[str, Sequence[float]], dict[str, Any]]] = {
    "gap": ({"shroud.gap": (-1e-5, 0.0, 1e-5, 5e-5)}, {}),
    "alpha": ({"shroud.alpha": (0.8, 1.0, 1.2)}, {}),
    "l_oa": ({"shroud.l_oa": (0.04, 0.05)}, {}),
    "F_0": ({"drive.F_0": (10.0, 30.0, 80.0)}, {}),
    "F_0 of one blade": ({"drive.F_0[1]": (10.0, 30.0, 80.0)}, {}),
    "M_0": ({"drive.M_0": (0.0, 0.3, 1.0, 10.0)}, {}),
    "omega": ({"drive.omega": (300.0, 536.0, 900.0)}, {}),
    "phase": ({"drive.phase[1]": (0.0, 1.0, 2.0)}, {}),
    "mu": ({"friction.mu": (0.0, 0.1, 0.9)}, {}),
    "k_d": ({"friction.k_d": (1e5, 1e6, 3e6)}, {}),
    "m of one blade": ({"blades.m[0]": (0.07, 0.08)}, {}),
    "I": ({"blades.I": (3e-4, 2e-3)}, {}),
    "start": ({"initial.x[0]": (-1e-4, 0.0, 1e-4)}, {}),
    "gamma and gap": ({"contact.gamma": (2.0, 4.0, 6.0), "shroud.gap": (1e-5, 3e-5)}, {}),
    "F_0 and M_0": ({"drive.F_0": (30.0, 60.0), "drive.M_0": (0.5, 50.0)}, {}),
    "forward": ({"contact.gamma": (2.0, 2.5, 3.0)}, {"direction": "forward"}),
    "backward": ({"contact.gamma": (2.0, 2.5, 3.0)}, {"direction": "backward"}),
    "two forward": ({"contact.gamma": (2.0, 3.0), "shroud.gap": (1e-5, 3e-5)}, {"direction": "forward"}),
    "two backward": ({"contact.gamma": (2.0, 3.0), "shroud.gap": (1e-5, 3e-5)}, {"direction": "backward"}),
    "at another phase": ({"contact.gamma": (2.0, 4.0)}, {"phase": 1.0}),
    "forward at another phase": ({"contact.gamma": (2.0, 4.0)}, {"phase": 4.0, "direction": "forward"}),
    "automatic steps": ({"contact.gamma": (2.0, 4.0)}, {"steps": "auto"}),
    "tight period": ({"contact.gamma": (2.0, 4.0)}, {"period_tol": 1e-9}),
}


def axes() -> Iterator[Run]:
    """Other axes and other arguments."""
    for (source, moment), (name, (along, changed)) in product((("table1", 100), ("table1_light", 0.3)), AXES.items()):
        if moment < 1 and changed:
            continue

        def does(given: Given, source=source, moment=moment, along=along, changed=changed) -> Values:
            scene = given.scene(source, "drive.F_0=60", f"drive.M_0={moment}")
            return diagram(swept(scene, along, method(*PLAIN), **{"n_periods": 3, "transient": 1, **changed}))

        yield Run("sweep, axes", f"{name}, {source}", "few periods", does)


def sweeps_of_models() -> Iterator[Run]:
    """Models made of other parts, many lanes."""
    for name in ("x", "rigid neighbour", "no friction", "no contact", "smooth contact", "printed"):

        def does(given: Given, parts=MODELS[name]) -> Values:
            scene, along = given.scene("table1", "drive.F_0=60", *parts), {"contact.gamma": (1.0, 2.5, 6.0)}
            return diagram(swept(scene, along, method(*PLAIN), n_periods=3, transient=1, steps=800))

        yield Run("sweep, models", name, "few periods", does)


def diagram_of_settled(came: js.SweepResult) -> Values:
    """P_d of orbits, and intervals of what is none."""
    known = came.P_d_settled & came.settled & (came.period_number > 0)
    orbit, rest = np.where(known, came.P_d, np.nan), np.where(known, np.nan, came.P_d)
    return {
        "P_d": rows(orbit),
        "P_d interval": rows(rest, came.P_d_ci),
        "period number": np.where(known, came.period_number, 0),
        "status": came.status,
        "P": rows(np.where(known[..., None], came.P, np.nan)),
    }


def settled() -> Iterator[Run]:
    """Many scenes after their transients."""
    along = {
        "gamma": {"contact.gamma": np.linspace(0.3, 4.5, 15)},
        "gap": {"shroud.gap": np.linspace(1e-6, 2e-4, 12)},
        "F_0": {"drive.F_0": np.linspace(5, 80, 12)},
    }
    for (name, axis), how in product(
        along.items(), (PLAIN, ("tsit5", "cubic", "float64"), ("rk4", "cubic", "float32"))
    ):

        def does(given: Given, axis=axis, how=how) -> Values:
            scene = given.scene("table1", "contact.gamma=2.6", "drive.F_0=60")
            return diagram_of_settled(swept(scene, axis, method(*how), n_periods=64, transient=300, steps=200))

        yield Run("sweep, settled", f"{name}, {', '.join(how)}", "settled", does, how[2])


# Power


def power(scene: js.Scene, how: Method, most_periods: int, transient: int) -> dict[str, Any]:
    """The last word of `power`."""
    came = js.power(
        scene,
        n_periods=most_periods,
        transient=transient,
        method=how.replace(steps=200),
        stable_within=1e-6,
        period_tol=1e-3,
    )
    return came.final


def powers() -> Iterator[Run]:
    """Orbits: P_d; chaos: intervals."""
    orbits = {f"gamma {gamma}": ("table1", f"contact.gamma={gamma}", "drive.F_0=60") for gamma in (0.3, 1.5, 2.5, 4.2)}
    ways = ((PLAIN, True), (("tsit5", "bisection", "float64"), True), (PLAIN, False))
    for (name, scene), (words, ledger) in product(orbits.items(), ways):
        how = method(*words)

        def does(given: Given, scene=scene, how=how) -> Values:
            end = power(given.scene(*scene), how, 128, 200)
            told = [end[key] for key in ("n", "stable", "settled", "period_number", "status")]
            values = {"P_d": np.array([[end["P_d"]]]), "P": rows(end["P"], end["P_0"]), "told": np.array(told)}
            return values | {"energy absolute": np.array([[end["energy_residual"]]])}

        yield Run("power", f"{name}, {how}{', ledger' if ledger else ''}", "settled", does)


def chaotic_powers() -> Iterator[Run]:
    """Chaos by its intervals."""
    for (name, (gamma, moment)), how in product(CHAOTIC.items(), (PLAIN, ("rk4", "cubic", "float32"))):

        def does(given: Given, gamma=gamma, moment=moment, how=how) -> Values:
            scene = given.scene("table1", f"contact.gamma={gamma}", f"drive.M_0={moment}", "drive.F_0=60")
            end = power(scene, method(*how), 512, 100)
            return {"P_d interval": rows(end["P_d"], end["ci"]), "status": np.asarray(end["status"])}

        yield Run("chaos", f"power, {name}, {how[2]}", "chaotic", does, how[2])


# Orbits and derivatives

ORBITS = {
    "gamma 0.3": ("table1", "contact.gamma=0.3", "drive.F_0=60"),
    "gamma 1.5": ("table1", "contact.gamma=1.5", "drive.F_0=60"),
    "gamma 2.5": ("table1", "contact.gamma=2.5", "drive.F_0=60"),
    "gamma 4.2": ("table1", "contact.gamma=4.2", "drive.F_0=60"),
    "F_0 20": ("table1", "contact.gamma=2.6", "drive.F_0=20"),
}
WRT = ("shroud.gap", "contact.gamma", "drive.F_0", "friction.mu", "blades.c_x", "drive.omega")
SHOOTING = (PLAIN, ("dopri8", "bisection", "float64"), ("rk4", "cubic", "float32"))


@cache
def found(moved: float, name: str, how: tuple[str, str, str]) -> js.Orbit:
    """An orbit of a scene that is moved so much."""
    precise = how[2] == "float64"
    return js.orbit(
        Given({}, moved).scene(*ORBITS[name]),
        state=None,
        q=None,
        most_periods=512,
        method=method(*how).replace(steps=TABLEAUS[how[0]]),
        tolerance=1e-11 if precise else 1e-7,
    )


def shot(orbit: js.Orbit) -> Values:
    """What `orbit` gives."""
    return {
        "start": rows(*orbit.start.motion),
        "P_d": np.array([[orbit.P_d]]),
        "P": rows(orbit.P, orbit.P_0),
        "multipliers": rows(np.abs(orbit.multipliers)),
        "conditioning": np.array([[orbit.conditioning]]),
        "period number": np.asarray(orbit.q),
        "flags": text(", ".join(orbit.flags)),
    }


def derived(got: js.Gradient) -> Values:
    """What an exact gradient gives."""
    return {
        "value": np.array([[got.value[key]] for key in got.value]),
        "P_d" if got.of == "P_d" else "P": np.array([[got.level]]),
        "flags": text(", ".join(got.flags)),
        "kind": text(got.kind),
    }


def gradient(scene: js.Scene, of: str, at: js.Orbit | None, how: Method, **smoothing: Any) -> Any:
    """`gradient` with all its arguments."""
    more = {"sigma": 0.01, "pairs": 16, "n_periods": 32, "transient": 32, "most_periods": 512, "seed": 3} | smoothing
    steps = TABLEAUS[how.tableau.name]
    wrt = [key for key in WRT if how.precision == "float64" or key != "contact.gamma"]  # which raises in float32
    return js.gradient(scene, wrt, of=of, orbit=at, method=how.replace(steps=steps), **more)  # type: ignore[arg-type]


def orbits() -> Iterator[Run]:
    """Orbits by shooting, and their exact gradients."""
    for how, name in product(SHOOTING, ORBITS):

        def closes(given: Given, how=how, name=name) -> Values:
            return shot(found(given.moved, name, how))

        yield Run("orbit", f"{name}, {', '.join(how)}", "derivative", closes, how[2])
        for of in ("P_d", "P"):

            def slopes(given: Given, how=how, name=name, of=of) -> Values:
                at = found(given.moved, name, how)
                return derived(gradient(at.scene, of, at, method(*how)))

            yield Run("gradient", f"{of}, {name}, {', '.join(how)}", "derivative", slopes, how[2])


def followed() -> Iterator[Run]:
    """An orbit that is followed; differences of followed orbits."""

    def next_one(given: Given) -> Values:
        at = found(given.moved, "gamma 2.5", PLAIN)
        scene = given.scene("table1", "contact.gamma=2.51", "drive.F_0=60")
        how, steps = method(*PLAIN), TABLEAUS["rk4"]
        return shot(
            js.orbit(scene, state=at.start, q=at.q, most_periods=64, method=how.replace(steps=steps), tolerance=1e-11)
        )

    def slopes_nearby(given: Given) -> Values:
        at = found(given.moved, "gamma 2.5", PLAIN)
        slopes = differences(at, WRT[:3], 1e-4, "P_d")
        return {"value": np.array([[slopes[key]] for key in slopes])}

    yield Run("orbit", "followed", "derivative", next_one)
    yield Run("gradient", "differences", "derivative", slopes_nearby)


def smoothed() -> Iterator[Run]:
    """Slopes across neighbourhoods in chaos."""
    for (name, (gamma, moment)), of in product(CHAOTIC.items(), ("P_d", "P")):
        if moment == 100.0:
            continue

        def does(given: Given, gamma=gamma, moment=moment, of=of) -> Values:
            scene = given.scene("table1", f"contact.gamma={gamma}", f"drive.M_0={moment}", "drive.F_0=60")
            got = gradient(scene, of, None, method(*PLAIN), most_periods=32)
            level = {"level interval": rows(got.level, got.level_ci)}
            return level | {
                "value interval": rows(*([by[key] for key in WRT] for by in (got.value, got.ci))),
                "kind": text(got.kind),
            }

        yield Run("chaos", f"gradient of {of}, {name}", "chaotic", does)


def exponents() -> Iterator[Run]:
    """Lyapunov exponents."""

    def measured(scene: js.Scene, n_periods: int, how: Method) -> js.Lyapunov:
        return js.lyapunov(scene, n_periods=n_periods, transient=64, method=how.replace(steps=400))

    for name in ("gamma 0.3", "gamma 2.5", "gamma 4.2"):

        def settled(given: Given, name=name) -> Values:
            got = measured(given.scene(*ORBITS[name]), 16, method(*PLAIN))
            return {"exponents": rows(got.exponents[:4]), "status": np.asarray(int(got.status))}

        yield Run("lyapunov", name, "derivative", settled)
    for name, (gamma, moment) in CHAOTIC.items():

        def chaotic(given: Given, gamma=gamma, moment=moment) -> Values:
            scene = given.scene("table1", f"contact.gamma={gamma}", f"drive.M_0={moment}", "drive.F_0=60")
            got = measured(scene, 96, method(*PLAIN))
            return {"exponent interval": rows(got.exponents[:1], got.ci[:1]), "status": np.asarray(int(got.status))}

        yield Run("chaos", f"lyapunov, {name}", "chaotic", chaotic)


# Design, accuracy, cost


def tuned() -> Iterator[Run]:
    """Small searches."""
    limits = {"no limit": (np.inf, np.inf), "limits": (2e-4, 60.0)}
    for name, goal in (("no limit", "mean"), ("no limit", "worst"), ("limits", "mean")):
        penetration, force = limits[name]

        def does(given: Given, goal=goal, penetration=penetration, force=force) -> Values:
            came = js.tune(
                given.scene("table1", "contact.gamma=2.5", "drive.F_0=30"),
                {"shroud.gap": (1e-5, 1e-4)},
                conditions={"drive.F_0": (20.0, 30.0)},
                goal=goal,
                most_penetration=penetration,
                most_force=force,
                search=js.SearchOptions(scan=4, n_starts=1, updates=2),
                n_periods=8,
                transient=8,
                method=method(*PLAIN).replace(steps=200),
                seed=5,
            )
            told = [came.confirmed, came.feasible, came.periods]
            by_start = [check.objective[0] for check in came.checks.values()]
            return {
                "design": np.array([[value] for value in came.design.values()]),
                "objective": rows([came.objective, *by_start]),
                "path": rows(came.points),
                "scores": rows(np.where(np.isfinite(came.scores), came.scores, np.nan)),
                "told": np.array(told),
            }

        yield Run("tune", f"{goal}, {name}", "derivative", does)


def traded() -> Iterator[Run]:
    """Errors of a few ways to march; what they cost is not told."""

    def does(given: Given) -> Values:
        trade = import_module("jaxshroud.verbs.trade")
        setting = import_module("jaxshroud.verbs.accuracy").Setting
        ways = [trade.by_setting(setting("rk4", locate, "float64", 0.5)) for locate in ("cubic", "none")]
        scene = given.scene("table1", "contact.gamma=2.5", "drive.F_0=60")
        came = trade.trade(scene, methods=ways, lanes=8, transient=8, n_periods=8, seed=0)
        return {
            "state": np.array([[way.state_error, way.state_error_median] for way in came]),
            "gradient": np.array([[way.gradient] for way in came]),
            "steps": np.array([way.steps_per_period for way in came]),
        }

    yield Run("trade", "located or not", "errors", does)


def explained() -> Iterator[Run]:
    """What models consist of; how many operations they take is told, and not held to anything."""
    for name, parts in {"full": (), **MODELS}.items():

        def does(given: Given, parts=parts) -> Values:
            got = js.explain(given.scene("table1", "drive.F_0=60", *parts), method(*PLAIN))
            return {
                "numbers": np.array([got.numbers, len(got.advice), *got.steps.values()]),
                "events": text(", ".join(got.events)),
                "omega_max": np.array([[got.omega_max]]),
                "operations free": np.array([[got.operations, got.full_operations]], float),
            }

        yield Run("explain", name, "one period", does)


def analysed() -> Iterator[Run]:
    """Plain functions of scenes and of series."""
    series = np.random.default_rng(7).standard_normal(512)

    def spectrum(window: str) -> Values:
        return {"amplitudes": rows(js.amplitude_spectrum(series, 16, window)[1])}

    for window in ("rectangular", "hann"):
        yield Run("analysis", f"spectrum, {window}", "one period", lambda _, window=window: spectrum(window))
    for q in (1, 3, 0):

        def period(_, q=q) -> Values:
            x = np.resize(series[:q], 128) if q else series
            told = js.periodicity(x, 1e-3)
            return {"number": np.array([int(np.asarray(a)) for a in told])}

        yield Run("analysis", f"period, {q}", "one period", period)
    for name, scene in FULL.items():

        def free(given: Given, scene=scene) -> Values:
            made = given.scene(*scene)
            steps = [
                import_module("jaxshroud.march.stability").steps_for(made, 0, "auto", js.tableau(name))
                for name in TABLEAUS
            ]
            P_0, omega_max = free_power(made), js.largest_frequency(made)
            return {"P_0": rows(P_0), "omega_max": rows(omega_max), "steps": np.array(steps)}

        yield Run("analysis", f"free motion, {name}", "one period", free)


# Maps of one period


def attractors() -> dict[str, tuple[tuple[str, ...], int]]:
    """Scene and number of periods from rest of 200 states."""
    consistent = ("table1", "drive.F_0=60")
    states = {f"gamma {g:.3g}": ((*consistent, f"contact.gamma={g}"), 50) for g in np.linspace(0.3, 8, 40)}
    for mm in np.linspace(0.001, 0.2, 24):
        states[f"gap {mm:.3g} mm"] = (*consistent, "contact.gamma=2.6", f"shroud.gap={mm} mm"), 50
    for F_0 in np.linspace(5, 80, 16):
        states[f"F_0 {F_0:.3g}"] = ("table1", "contact.gamma=2.6", f"drive.F_0={F_0}"), 50
    for M_0, gamma in product((0.1, 0.2, 0.5, 1.0), np.linspace(0.5, 10, 14)):
        states[f"light, M_0 {M_0}, gamma {gamma:.3g}"] = (
            ("table1_light", f"drive.M_0={M_0}", f"contact.gamma={gamma}"),
            50,
        )
    for gamma in np.linspace(1, 8, 16):
        states[f"printed, gamma {gamma:.3g}"] = (*consistent, "contact.reading=printed", f"contact.gamma={gamma}"), 50
    for (name, (gamma, moment)), n in product(CHAOTIC.items(), range(100, 116)):
        scene = (*consistent, f"contact.gamma={gamma}", f"drive.M_0={moment}")
        states[f"chaos, {name}, {n} periods"] = scene, n
    return states


def on_attractors() -> Values:
    """The states: motion, slider, mode and case (15,)."""
    given, stored, known = Given({}), {}, (None, 0, None)
    for name, (scene, periods) in attractors().items():
        before, state = known[1:] if known[0] == scene else (0, None)
        last = simulated(given.scene(*scene), method(*PLAIN), periods - before, 400, state).last
        known = scene, periods, last
        stored[name] = np.append(rows(*last.motion), [float(last.u_s), int(last.mode), int(last.case)])
    return stored


def state_of(vector: np.ndarray) -> js.State:
    """A stored state."""
    motion = js.Motion(*(jnp.asarray(vector[i : i + 2]) for i in range(0, 12, 2)))
    mode, case = (jnp.asarray(int(n), jnp.int32) for n in vector[13:])
    return js.State(motion, jnp.asarray(vector[12]), mode, case)


def image(scene: js.Scene, state: js.State, how: tuple[str, str, str]) -> Values:
    """Where a state is after one period, and how often contact changed."""
    steps = TABLEAUS[how[0]]
    came = simulated(scene, method(*how), 1, steps, state)
    size = np.array([[np.max(np.abs(a))] for a in came.motion], np.float32)
    return {
        "motion": rows(*(a[-1] for a in came.motion)),
        "motion size": size,
        "slider": came.u_s[-1:][None],
        "slider size": size[:1],
        "events": counted(came.counters).astype(np.int16),
        "contact": np.array([came.mode[-1], came.case[-1], came.status], np.int8),
    }


def maps() -> Iterator[Run]:
    """One period from every stored state."""
    for how, (name, (scene, _)) in product(MAPS, attractors().items()):
        if name.startswith("printed") and how != PLAIN:
            continue

        def does(given: Given, how=how, name=name, scene=scene) -> Values:
            return image(given.scene(*scene), state_of(given.starts[name]), how)

        yield Run(f"map, {', '.join(how)}", name, "one period", does, how[2])


@cache
def compiled_map(derivative: bool) -> Callable:
    """`period_map` of many lanes, or its derivative by the gap."""

    def value(scene: js.Scene, state: js.State):
        how = method(*PLAIN)
        return js.period_map(scene, state, n_periods=2, method=how.replace(steps=400), most_trials=None)

    def by_gap(scene: js.Scene, state: js.State):
        gap = scene.shroud.gap
        along = lambda gap: value(js.vary(scene, "shroud.gap", gap), state).power
        return jax.jvp(along, (gap,), (jnp.ones_like(gap),))[1]

    return jax.jit(jax.vmap(by_gap if derivative else value))


def period_maps() -> Iterator[Run]:
    """`period_map` and its derivative, inside `jit` and `vmap`; of a small model, as the full one compiles slowly."""
    for derivative, gammas in product((False, True), ((0.5, 2.5), (4.0, 5.0), (7.0, 9.0))):

        def does(given: Given, derivative=derivative, gammas=gammas) -> Values:
            parts = ("drive.F_0=60", *MODELS["x"])
            pairs = [
                (given.scene("table1", f"contact.gamma={gamma}", *parts), state_of(np.zeros(15))) for gamma in gammas
            ]
            got = compiled_map(derivative)(*jax.tree.map(lambda *a: jnp.stack(a), *pairs))
            if derivative:
                return {"slopes": rows(*got)}
            return {"motion": rows(*got.state.motion), "power": rows(*got.power), "status": np.asarray(got.status)}

        told = f"{'jvp' if derivative else 'value'}, gamma {gammas[0]} and {gammas[1]}"
        yield Run("period_map", told, "derivative" if derivative else "few periods", does)


GROUPS = (
    *(simulations, models, shipped, stopped, sweeps, axes, sweeps_of_models, settled, powers, chaotic_powers),
    *(orbits, followed, smoothed, exponents, tuned, traded, explained, analysed, period_maps, maps),
)


def runs() -> list[Run]:
    """All of them, by groups."""
    return sorted((run for made in GROUPS for run in made()), key=lambda run: run.group)
