"""Where the modules of version 0.1.0 are now: their names still work, with a warning."""

import sys
import warnings
from collections.abc import Callable, Sequence
from importlib import import_module
from types import ModuleType
from typing import Any

PLACES = {
    "checks": "scene.precision scene.checks",
    "extent": "scene.limits batch.extent",
    "absent": "model.absent",
    "state": "model.modes model.state",
    "trig": "model.trig",
    "geometry": "model.geometry",
    "linear": "model.linear",
    "contact": "model.contact",
    "friction": "model.ready model.friction",
    "compiled": "batch.xla",
    "lanes": "batch.xla",
    "threads": "batch.threads",
    "rhs": "model.state batch.states model.ready model.rhs",
    "events": "march.events",
    "tableau": "march.tableau",
    "locate": "march.locate",
    "within": "march.within",
    "implicit": "march.implicit",
    "integrate": "batch.loop march.energy batch.xla march.method march.trial march.step march.lane",
    "stability": "scene.limits march.stability",
    "periods": "batch.periods",
    "chatter": "batch.chatter",
    "free": "batch.free",
    "analysis.interval": "motion.interval",
    "analysis.period": "motion.period",
    "analysis.power": "motion.power",
    "analysis.settling": "motion.settling",
    "analysis.spectrum": "motion.spectrum",
    "sweep": "scene.parts scene.grids batch.states batch.runs batch.continuation motion.averages "
    "results.sweep verbs.sweep",
    "power": "results.power verbs.power",
    "trajectory": "results.trajectory verbs.simulate",
    "explain": "verbs.explain",
    "tangents": "batch.states batch.tangents",
    "periodmap": "batch.periodmap",
    "orbit": "results.orbit verbs.orbit motion.orbit motion.shooting motion.margins",
    "gradient": "results.gradient verbs.gradient motion.gradient",
    "lyapunov": "results.lyapunov verbs.lyapunov motion.lyapunov",
    "tune": "results.tuned verbs.tune verbs.design verbs.climb verbs.confirm",
    "setting": "verbs.setting",
    "adaptive": "verbs.adaptive",
    "trade": "verbs.trade",
    "accuracy": "verbs.accuracy",
    "schema": "scene.schema scene.units",
    "config": "scene.config scene.overrides",
    "files": "results.files scene.errors",
    "store": "results.dimension results.store cli.store",
    "earlier": "results.earlier",
    "drawing": "results.drawing",
    "plot": "results.plot results.plot_run results.panels results.plot_power",
    "plot_design": "results.plot_design",
    "keyboard": "cli.keyboard",
    "terminal": "cli.terminal cli.words cli.parser cli.asked",
    "cli_design": "cli.parser cli.gradient cli.tune",
    "cli_plot": "cli.plot cli.parser",
    "cli_trade": "cli.trade cli.parser",
    "analysis": "",
}


def getter(old: str, places: Sequence[str]) -> Callable[[str], Any]:
    """A module's `__getattr__`, which finds the names of the module `old` in their new `places`."""

    def find(name: str) -> Any:
        for place in places if not name.startswith("__") else ():
            found = getattr(import_module(f"jaxshroud.{place}"), name, None)
            if found is not None:
                told = f"jaxshroud.{old} is deprecated: {name} is in jaxshroud.{place}"
                warnings.warn(told, DeprecationWarning, stacklevel=2)
                return found
        raise AttributeError(f"module 'jaxshroud.{old}' has no attribute {name!r}")

    return find


def stand_in(old: str, places: str) -> ModuleType:
    """What stands for a module that is no longer there."""
    module = ModuleType(f"jaxshroud.{old}")
    vars(module)["__getattr__"] = getter(old, places.split())
    return module


# Found there, they are not set as attributes of the package, where a function may have the same name.
sys.modules |= {f"jaxshroud.{old}": stand_in(old, places) for old, places in PLACES.items()}
