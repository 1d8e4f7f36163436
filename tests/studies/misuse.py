"""Public functions called with arguments of wrong types: what is refused in one line, and what is not.

Each argument of each public function, of each constructor of what scenes are made of, and of each method of results is
replaced by each of the `WRONG` values, all others being right. A value is wrong for an argument where its annotation
does not allow it, by beartype's judgement, and where a boolean stands for a number. Wrong ones must end in one line of
the package's own errors; right ones must not end in any other error.

    python tests/studies/misuse.py
"""

import argparse
import inspect
import json
import tempfile
import warnings
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import chdir, nullcontext
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple, get_args
from unittest.mock import patch

import jax
import matplotlib as mpl
import numpy as np
from beartype import BeartypeConf
from beartype.door import is_bearable
from jaxtyping import ArrayLike

import jaxshroud as js
from jaxshroud.batch import xla
from jaxshroud.model.linear import free_power
from jaxshroud.model.spring_contact import NoContact
from jaxshroud.orbits.verdict_evidence import zero_one
from jaxshroud.scene.checks import Error
from jaxshroud.verbs.gradient import differences
from jaxshroud.verbs.tune import objective_map

TOWER = BeartypeConf(is_pep484_tower=True)  # a whole number is a number
Numbers = ArrayLike | Sequence[ArrayLike]
RUN = dict(n_periods=1, transient=0, method=js.RungeKutta(steps=100))
WRONG: dict[str, Any] = {
    "None": None,
    "True": True,
    "0": 0,
    "-1": -1,
    "3": 3,
    "1.5": 1.5,
    "nan": float("nan"),
    "1j": 1j,
    "''": "",
    "'x'": "x",
    "b'x'": b"x",
    "[]": [],
    "['x']": ["x"],
    "[None]": [None],
    "[True]": [True],
    "[1.0, 2.0]": [1.0, 2.0],
    "(1, 'x')": (1, "x"),
    "{}": {},
    "{'x': 1}": {"x": 1},
    "{1: 'x'}": {1: "x"},
    "{'shroud.gap': 'x'}": {"shroud.gap": "x"},
    "{'shroud.gap': True}": {"shroud.gap": True},
    "object": object(),
    "type": int,
    "function": lambda *_: "x",
    "no numbers": np.zeros(0),
    "no rows": np.zeros((0, 3)),
    "words": np.array(["a", "b"]),
    "objects": np.array([None, 1]),
}


class Began(BaseException):
    """The arguments were taken, and what takes long would begin."""


class Target(NamedTuple):
    """What is called, with arguments that are right."""

    call: Callable[..., Any]
    right: dict[str, Any]
    long: bool = False  # not computed

    def hint(self, name: str) -> Any:
        """What an argument is annotated with; what is converted to an array may be what can be one."""
        found = inspect.signature(self.call).parameters[name].annotation
        array = "Mapping" not in str(found) and ("jaxlib" in str(found) or str(found).startswith("jaxtyping"))
        return Any if isinstance(found, str) or found is inspect.Parameter.empty else Numbers if array else found


class Outcome(NamedTuple):
    """What came of one call."""

    target: str
    argument: str
    value: str
    allowed: bool  # by the annotation
    ended: str  # "accepted", "refused", or the name of another exception
    told: str

    @property
    def fault(self) -> str | None:
        """What is wrong with it."""
        if self.ended not in ("accepted", "refused"):
            return self.ended
        if "\n" in self.told:
            return "lines"
        return "accepted though wrong" if self.ended == "accepted" and not self.allowed else None


@cache
def scene() -> js.Scene:
    """One degree of freedom: compiled in a second."""
    return js.load("table1", ['parts.motion=["x"]', "parts.friction=none", "parts.neighbour=rigid"]).scene


@cache
def file() -> js.SceneFile:
    """The same."""
    return js.load("table1", ['parts.motion=["x"]', "parts.friction=none", "parts.neighbour=rigid"])


@cache
def functions() -> dict[str, Target]:
    one, over, ends = scene(), {"shroud.gap": [1e-5, 2e-5]}, {"shroud.gap": (1e-5, 2e-5)}
    state = js.simulate(one, n_periods=1, method=js.RungeKutta(steps=100)).last
    steps = {"method": js.RungeKutta(steps=100)}
    orbit = js.orbit(one, **steps)
    axis = np.linspace(0.0, 1.0, 64)
    measured = {"t [s]": [0.0, 1e-3, 2e-3], "x_left [m]": [0.0, 1e-5, 2e-5]}
    own, chain = js.with_contact_law(one, js.Laws(js.Hertz(4e7))), js.load("row_chain5", ['parts.motion=["x"]']).scene
    return {
        "amplitude_spectrum": Target(js.amplitude_spectrum, {"signal": axis, "samples_per_period": 8}),
        "attractors": Target(js.attractors, {"scene": one, **steps}, True),
        "basins": Target(js.basins, {"scene": one, **steps}, True),
        "branch": Target(js.branch, {"scene": one, "along": "shroud.gap", "start": 1e-5, "stop": 3e-5, **steps}, True),
        "cache_compilations": Target(js.cache_compilations, {"folder": "compiled"}),
        "check": Target(js.check, {"scene": one}),
        "check_laws": Target(js.check_laws, {"scene": own}),
        "diagnose": Target(js.diagnose, {"scene": one, **steps}, True),
        "differences": Target(differences, {"found": orbit, "wrt": ["shroud.gap"], "step": 1e-3}, True),
        "explain": Target(js.explain, {"scene": one}),
        "fit": Target(js.fit, {"scene": one, "measurements": measured, "over": ends, **steps}, True),
        "free_power": Target(free_power, {"scene": one}),
        "gradient": Target(js.gradient, {"scene": one, "wrt": ["shroud.gap"], **RUN}, True),
        "largest_frequency": Target(js.largest_frequency, {"scene": one}),
        "load": Target(js.load, {"source": "table1"}),
        "lyapunov": Target(js.lyapunov, {"scene": one, **RUN}, True),
        "mistune": Target(
            js.mistune, {"scene": chain, "along": {"drive.omega": [1e3, 2e3]}, "linear": "stuck", "n_patterns": 2}
        ),
        "most_trials": Target(js.most_trials, {"scene": one, **steps}),
        "objective_map": Target(objective_map, {"tuned": None, "n": 3}, True),
        "open": Target(js.open, {"path": "run.nc"}),
        "orbit": Target(js.orbit, {"scene": one, **steps}, True),
        "period_map": Target(js.period_map, {"scene": one, "state": state, **steps}),
        "periodicity": Target(js.periodicity, {"x": axis}),
        "power": Target(js.power, {"scene": one, **RUN}),
        "report": Target(js.report, {"scene": one, **RUN}, True),
        "response": Target(
            js.response, {"scene": one, "along": "shroud.gap", "start": 1e-5, "stop": 3e-5, **RUN}, True
        ),
        "rollout": Target(js.rollout, {"scene": one, **steps}),
        "scatter": Target(js.scatter, {"scene": one, "scatters": ends, **RUN}, True),
        "scenes_from": Target(js.scenes_from, {"table": over, "base": one}),
        "shipped": Target(js.shipped, {}),
        "simulate": Target(js.simulate, {"scene": one, "n_periods": 1, **steps}),
        "stack_scenes": Target(js.stack_scenes, {"scenes": [one, one]}),
        "sweep": Target(js.sweep, {"scene": one, "along": over, **RUN}),
        "sweep_function": Target(js.sweep_function, {"n_periods": 1, "transient": 0, **steps}),
        "sweep_function()": Target(
            js.sweep_function(1, 0, method=js.RungeKutta(steps=100)), {"scenes": js.stack_scenes([one])}
        ),
        "table": Target(js.table, {"scene": one, "designs": {"shroud.gap [um]": [10.0, 20.0]}, **RUN}, True),
        "tableau": Target(js.tableau, {"name": "rk4"}),
        "trade": Target(js.trade, {"scene": one}, True),
        "tune": Target(js.tune, {"scene": one, "over": ends, **RUN}, True),
        "value_of": Target(js.value_of, {"scene": one, "key": "shroud.gap"}),
        "vary": Target(js.vary, {"scene": one, "key": "shroud.gap", "value": 1e-5}),
        "with_contact_law": Target(js.with_contact_law, {"scene": one, "law": NoContact()}),
        "zero_one": Target(zero_one, {"series": axis, "near": 0.0}),
    }


def made() -> dict[str, Target]:
    """What scenes and methods are made of."""
    one = scene()
    numbers = lambda holder: {name: getattr(holder, name) for name in holder.__dataclass_fields__}
    laws = {
        js.Laws: {"normal": js.Hertz(4e7)},
        js.Hertz: {"k": 4e7},
        js.DampedSpring: {"k": 2e5, "k_deep": 6e5, "depth": 3e-5, "c": 20.0},
        js.RegularisedCoulomb: {"mu": 0.3, "speed": 1e-3},
        js.LuGre: {"k_d": 1e6, "c": 30.0, "mu": 0.3, "N_0": 1.0},
    }
    tables = [one.blades, one.shroud, one.contact, one.friction, one.drive, one]
    made = {type(part).__name__: Target(type(part), numbers(part)) for part in tables}
    made |= {law.__name__: Target(law, right) for law, right in laws.items()}
    return {
        **made,
        "Motion": Target(_started, dict.fromkeys(js.Motion._fields, 0.0)),
        "Parts": Target(js.Parts, js.Parts()._asdict()),
        "RungeKutta": Target(js.RungeKutta, {"tableau": "rk4"}),
        "Taylor": Target(js.Taylor, {}),
        "method_for": Target(js.method_for, {"scenes": one, "accuracy": 1e-3}, True),
        "Method.replace": Target(_replaced, dict.fromkeys(("tableau", "locate", "precision"))),
        "State": Target(_state, {"motion": js.Motion(*[np.zeros(2)] * 6), "u_s": 0.0, "mode": 0, "case": 0}),
    }


def _started(x, y, theta, v_x, v_y, v_theta):
    one = scene()
    parts = one.blades, one.shroud, one.contact, one.friction, one.drive
    return js.Scene(*parts, js.Motion(x, y, theta, v_x, v_y, v_theta), one.parts)


def _replaced(tableau=None, locate=None, precision=None):
    """A method with some of its arguments replaced."""
    given = {"tableau": tableau, "locate": locate, "precision": precision}
    return js.RungeKutta().replace(**{name: a for name, a in given.items() if a is not None})


def _state(motion, u_s, mode, case):
    return js.simulate(scene(), js.State(motion, u_s, mode, case), n_periods=1, method=js.RungeKutta(steps=100))


def _methods() -> dict[str, Target]:
    """Those of results."""
    one = scene()
    results = {
        "sweep": js.sweep(one, {"shroud.gap": [1e-5, 2e-5]}, **RUN),
        "simulate": js.simulate(one, n_periods=1, method=js.RungeKutta(steps=100)),
        "power": js.power(one, **RUN),
        "orbit": js.orbit(one, method=js.RungeKutta(steps=100)),
    }
    results["simulate"].save("run.nc")
    right = {"path": "a.nc", "ax": None}
    found = {"SceneFile.text": Target(file().text, {})}
    for verb, result in results.items():
        names = [name for name, _ in inspect.getmembers(type(result), callable) if not name.startswith("_")]
        for name in names:
            call = getattr(result, name)
            asked = [a for a in inspect.signature(call).parameters.values() if a.kind != a.VAR_KEYWORD]
            if asked and not name.startswith("from_") and not name.startswith("of_"):
                found[f"{verb}(...).{name}"] = Target(call, {a.name: right.get(a.name, a.default) for a in asked})
    return found


def _asked(target: Target) -> Iterator[str]:
    """The arguments of a target by their names, those of any number too."""
    for a in inspect.signature(target.call).parameters.values():
        if a.kind != a.VAR_KEYWORD:
            yield a.name


def _called(target: Target, given: Mapping[str, Any]) -> Any:
    """The call, by names, with all positional arguments of any number as one."""
    kinds = inspect.signature(target.call).parameters
    by_place = [value for name, value in given.items() if kinds[name].kind in (0, 2)]
    by_name = {name: value for name, value in given.items() if kinds[name].kind not in (0, 2)}
    return target.call(*by_place, **by_name)


def outcome(name: str, target: Target, argument: str, word: str) -> Outcome:
    """What one call ends in."""
    value, hint = WRONG[word], target.hint(argument)
    allowed = _allows(hint, value)
    given = {key: a for key, a in target.right.items() if a is not inspect.Parameter.empty} | {argument: value}
    began = patch.object(xla, "is_traced", side_effect=Began) if target.long else nullcontext()
    ended, told = "accepted", ""
    with began, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            _called(target, given)
        except Began:
            pass
        except Error as error:
            ended, told = "refused", str(error)
        except Exception as error:
            own = callable(value) and allowed and hint is not Any  # raised by what the user gave
            own |= isinstance(error, IndexError) and argument == "at"  # documented
            ended, told = "refused" if own else type(error).__name__, str(error).partition("\n" if own else "\0")[0]
    return Outcome(name, argument, word, allowed, ended, told[:300])


def _allows(hint: Any, value: Any) -> bool:
    """Whether an annotation allows a value; a boolean is no number, and a number is not complex."""
    if isinstance(value, bool):
        return bool in (hint, *get_args(hint)) and len(get_args(hint)) < 5
    if isinstance(value, complex):
        return hint is Any
    if isinstance(value, np.ndarray) and "Sequence" in str(hint):
        value = value.tolist()
    return hint is Any or is_bearable(value, hint, conf=TOWER)


def targets() -> dict[str, Target]:
    """All that is called; where results are written."""
    found = {**functions(), **made(), **_methods()}
    public = {n for n in js.__all__ if inspect.isfunction(getattr(js, n))}
    assert public <= set(found), public - set(found)
    return found


def outcomes(of: Mapping[str, Target], words: Mapping[str, Any] = WRONG) -> list[Outcome]:
    """What all calls end in."""
    return [
        outcome(name, one, argument, word) for name, one in of.items() for argument in _asked(one) for word in words
    ]


def main() -> None:
    """Run the study and write its figures."""
    argparse.ArgumentParser(description=__doc__).parse_args()
    jax.config.update("jax_enable_x64", True)
    mpl.use("agg")
    with tempfile.TemporaryDirectory() as folder, chdir(folder):
        found = outcomes(targets())
        left = sorted(path.name for path in Path().iterdir())
    faults = [one for one in found if one.fault]
    figures = {
        "command": "python tests/studies/misuse.py",
        "version": js.__version__,
        "targets": len({one.target for one in found}),
        "arguments": len({(one.target, one.argument) for one in found}),
        "tried": len(found),
        "refused in one line": sum(one.ended == "refused" and one.fault is None for one in found),
        "accepted as allowed": sum(one.ended == "accepted" and one.allowed for one in found),
        "faults": Counter(one.fault for one in faults),
        "left behind": left,
    }
    Path(__file__).with_suffix(".json").write_text(json.dumps(figures, indent=1) + "\n")
    print(json.dumps(figures, indent=1))
    for one in faults:
        print(one.fault, f"{one.target}({one.argument}={one.value})", one.told[:120].replace("\n", " / "), sep=" | ")


if __name__ == "__main__":
    main()
