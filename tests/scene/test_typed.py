"""Arguments of public functions are held against their annotations, in one line that names what is wrong."""

from collections.abc import Callable, Mapping, Sequence
from inspect import isfunction, signature
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxshroud as js
from jaxshroud.march.method import Choices, Method
from jaxshroud.march.stability import steps_for
from jaxshroud.march.tableau import TaylorOptions
from jaxshroud.model.linear import free_power
from jaxshroud.orbits.verdict_evidence import zero_one
from jaxshroud.scene.scene import Scene
from jaxshroud.scene.typed import type_check

Numbers = signature(js.vary).parameters["value"].annotation


@pytest.fixture(scope="module")
def scene():
    return js.load("table1", ['parts.motion=["x"]']).scene


def refused(call, *args, **kwargs) -> str:
    """The one line of an InputError."""
    with pytest.raises(js.InputError) as caught:
        call(*args, **kwargs)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 300
    return str(caught.value)


SHORT = {"n_periods": 1, "method": js.RungeKutta(steps=100)}
VERBS = ["attractors", "basins", "check", "diagnose", "explain", "lyapunov", "orbit", "power", "report", "simulate"]


@pytest.mark.parametrize("verb", [*VERBS, "sweep", "trade", "largest_frequency", "rollout"])
@pytest.mark.parametrize("wrong", [None, "table1", 3, [1.0], {}, Scene])
def test_what_is_no_scene_is_refused(verb, wrong):
    assert refused(getattr(js, verb), wrong).startswith("Argument `scene` must be a Scene")


def test_a_name_in_the_place_of_a_scene_is_told_the_cure():
    told = "Argument `scene` must be a Scene or a SceneFile such as js.load(\"table1\"), but is 'table1'."
    assert refused(js.power, "table1") == told


@pytest.mark.parametrize(
    ("argument", "wrong", "told"),
    [
        ("method", "x", "must be fast, balanced, reference or a number from 1e-10 to 1e-2, but is 'x'"),
        ("method", True, 'must be a RungeKutta such as js.RungeKutta("dopri8"), a Taylor, a string or a number'),
        ("n_periods", True, "must be a whole number, but is True."),
        ("direction", "Forward", "cannot be 'Forward'; did you mean `forward`?"),
        ("phase", True, "must be a number, but is True."),
        ("along", {"contact.gamma": True}, "must be a dict of strings to numbers, but is {'contact.gamma': True}."),
        ("along", {"contact.gamma": "1"}, "must be a dict of strings to numbers"),
        ("along", ["contact.gamma"], "must be a dict of strings to numbers, but is ['contact.gamma']."),
        ("state", 0.0, "must be a State, but is 0.0."),
        ("ledger", "no", "must be True or False, but is 'no'."),
        ("store", int, "must be a string or a PathLike, but is <class 'int'>."),
        ("progress", 3, "must be a function, but is 3."),
        ("dims", "x", "must be a list of strings, but is 'x'."),
    ],
)
def test_each_kind_of_argument_is_held(scene, argument, wrong, told):
    given = {"along": {"contact.gamma": [1.0]}, **SHORT, argument: wrong}
    assert refused(js.sweep, scene, **given).startswith(f"Argument `{argument}` {told}")


@pytest.mark.parametrize(
    ("call", "told"),
    [
        (lambda: js.periodicity([]), "Argument `x` must be numbers, at least one"),
        (lambda: js.periodicity([[1.0], [1.0, 2.0]]), "Argument `x` must be numbers"),
        (lambda: js.periodicity(["a"]), "Argument `x` must be numbers, but is ['a']."),
        (lambda: js.periodicity([True]), "Argument `x` must be numbers"),
        (lambda: js.periodicity(np.float64(3.0)), "Argument `x` must be numbers, at least one"),
        (lambda: zero_one([]), "Argument `series` must be numbers"),
        (lambda: zero_one(np.zeros((3, 60)), [1.0, 2.0]), "Argument `near` must be one number, or one of each"),
        (lambda: js.amplitude_spectrum([], 8), "Argument `signal` must be numbers"),
        (lambda: js.amplitude_spectrum(np.zeros(16), "8"), "Argument `samples_per_period` must be a whole number or"),
        (lambda: js.Hertz(""), "Argument `k` of Hertz must be a number, but is ''."),
        (lambda: js.LuGre(1e6, True, 0.3, 1.0), "Argument `c` of LuGre must be a number, but is True."),
        (lambda: js.Friction(True, 0.5), "friction.k_d = True must be a valid number"),
        (lambda: js.Friction(None, 0.5), "friction.k_d = None must be a valid number"),
        (lambda: TaylorOptions(12, "x"), "Argument `tolerance` must be a number from"),
        (lambda: js.Parts(np.zeros(2)), "`motion` must be one of"),
        (lambda: js.cache_compilations(int), "Argument `folder` must be a string or a PathLike"),
        (lambda: js.open(3), "Argument `path` must be a string or a PathLike"),
        (lambda: js.load("table1", "contact.gamma=2"), "Argument `overrides` must be a list of strings"),
        (lambda: js.scenes_from([1.0], js.load("table1")), "a table needs columns that are called by keys"),
        (lambda: js.tableau(["rk4"]), "Argument `name` must be a string"),
        (lambda: js.attractors(js.load("table1"), seed=-1), "Argument `seed` must be a whole number of at least 0"),
        (lambda: js.trade(js.load("table1"), lanes=0), "Argument `lanes` must be positive, but is 0."),
        (lambda: steps_for(js.load("table1").scene, 1, "auto", None), "These scenes have 0 leading axes, not 1."),
        (lambda: js.vary(js.load("table1").scene, "shroud.gap", [1e-5, 2e-5]), "shroud.gap has the shape (), but its"),
    ],
)
def test_what_reached_the_inside_is_refused(call, told):
    assert refused(call).startswith(told)


def test_a_state_of_plain_numbers_is_refused(scene):
    assert "must be arrays" in refused(js.simulate, scene, js.State(scene.initial, 0.0, 0, 0), **SHORT)


@pytest.mark.full
def test_a_path_that_is_none_writes_nothing(scene, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    run = js.simulate(scene, **SHORT)
    for wrong in (str, 3, b"a.nc"):
        assert "`path` must be" in refused(run.save, wrong)
    assert "`ax` must be Axes of matplotlib" in refused(run.plot, 3)
    assert "`at` must be a whole number" in refused(run.lane, "x")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("annotation", "right", "wrong"),
    [
        (int, [3, np.int32(3)], [True, 3.0, "3", None]),
        (float, [3, 0.5, np.float32(1), np.ones(()), jnp.ones(())], [True, "1", 1j, np.ones(1), [1.0], None]),
        (bool, [True, np.True_], [1, None, "x"]),
        (Numbers, [1, [1, (2.0, 3)], range(3), np.ones(2), jnp.ones(2)], [True, [1, False], "1", ["1"], np.array("a")]),
        (Numbers | None, [None, 1, [1.0]], ["1", True]),
        (Sequence[str], [["a"], ("a",), np.array(["a"])], ["a", [1], {"a": 1}, {"a"}, None, np.array("a")]),
        (Mapping[str, tuple[float, float]], [{"a": (1, 2)}, {"a": np.ones(2)}], [{"a": 1}, {"a": (1,)}, {1: (1, 2)}]),
        (int | Literal["auto"] | None, [3, "auto", None], ["x", 1.0]),
        (Callable[[int, int], None] | None, [print, None], [3]),
        (Method, [js.RungeKutta(), js.Taylor()], ["rk4", None, Choices()]),
        (Any, [None, 3], []),
    ],
)
def test_kinds_hold_what_they_say(annotation, right, wrong):
    kind = type_check(annotation)
    assert [a for a in right if not kind.holds(a)] == []
    assert [a for a in wrong if kind.holds(a)] == []


def test_what_is_traced_is_known_by_its_type(scene):
    move = jax.vmap(lambda b: js.vary(scene, "drive.beta", [b, 0.0]).drive.beta)
    assert move(jnp.ones(3)).shape == (3, 2)
    assert jax.jit(lambda scene: free_power(scene))(scene).shape == (2,)


def test_what_is_missing_is_told_by_python():
    for call in (lambda: js.power(), lambda: js.power(js.load("table1"), none=3)):  # type: ignore[call-arg]
        with pytest.raises(TypeError):
            call()


FUNCTIONS = [name for name in js.__all__ if isfunction(getattr(js, name)) and signature(getattr(js, name)).parameters]


@pytest.mark.parametrize("name", FUNCTIONS)
def test_every_public_function_is_held(name):
    asked = signature(getattr(js, name)).parameters.values()
    needed = {a.name: object() for a in asked if a.default is a.empty} or {next(iter(asked)).name: object()}
    assert " must be " in refused(getattr(js, name), **needed)


@pytest.mark.release
@pytest.mark.full
def test_warnings_point_to_the_call():
    wild = js.load("table1", ["drive.M_0=1e5"])
    with pytest.warns(js.LaneWarning, match="ended with") as told:
        js.simulate(wild, n_periods=1, method=js.RungeKutta(steps=100))
    assert told[0].filename.endswith(("test_typed.py", "_decorator.py"))  # of the tests' own type checks
