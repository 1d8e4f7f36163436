"""Results as labelled datasets and as plain numbers, for files."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from jaxshroud.results.gradient import Gradient
from jaxshroud.results.power import PowerResult
from jaxshroud.results.store import plain
from jaxshroud.results.tuned import Tuned
from jaxshroud.scene.file import SceneFile
from jaxshroud.verbs.setting import HORIZON
from jaxshroud.verbs.trade import Measured, error_of, front
from jaxshroud.version import __version__


def named(result: Any, scene_file: SceneFile) -> Any:
    """A result that says which file its scene is from."""
    result.data.attrs |= _attrs(scene_file)
    return result


def sweep_dataset(result: Any, scene_file: SceneFile) -> Any:
    """The dataset of a sweep; as it was called before results had `to_xarray`."""
    return named(result, scene_file).to_xarray()


def trajectory_dataset(run: Any, scene_file: SceneFile, steps_per_period: int, every: int) -> Any:
    """The dataset of a run, likewise."""
    return named(run, scene_file).to_xarray()


def power_json(result: PowerResult, scene_file: SceneFile) -> dict[str, Any]:
    """A power convergence as plain numbers."""
    curve = {name: getattr(result, name).tolist() for name in ("n", "P_d", "P_d_ci")}
    return {**_attrs(scene_file), **curve, "final": result.final}


def gradient_json(found: Gradient, scene_file: SceneFile) -> dict[str, Any]:
    """A gradient as `gradient.json` holds it."""
    at = found.orbit
    told = {n: getattr(found, n) for n in ("of", "kind", "value", "ci", "level", "level_ci", "sigma", "flags")}
    told["number"] = {e.key: e.number for e in found.effects}
    orbit = {
        "period_number": at.q,
        "residual": at.residual,
        "multipliers": [[float(m.real), float(m.imag)] for m in at.multipliers],
        "nearest_bifurcation": at.bifurcation[0] if at.found else None,
        "conditioning": found.conditioning,
        "periods": at.periods,
        "start": {name: np.asarray(pair).tolist() for name, pair in at.start.motion._asdict().items()},
    }
    how = {"method": str(at.method), "steps_per_period": at.steps_per_period}
    return plain({**told, "orbit": orbit, **how, **_attrs(scene_file)})


def tune_json(tuned: Tuned, drawn: dict[str, Any] | None, scene_file: SceneFile) -> dict[str, Any]:
    """A tuning as `tune.json` holds it; `drawn` is the map of the objective."""
    problem = tuned.problem
    told = {n: getattr(tuned, n) for n in ("feasible", "design", "objective", "at_bounds", "confirmed", "periods")}
    search = {n: getattr(tuned, n) for n in ("points", "scores", "exact", "scanned", "scanned_scores")}
    limits = {"most_penetration": problem.most_penetration, "most_force": problem.most_force}
    asked = {"over": problem.over, "conditions": problem.conditions, "goal": problem.goal, **limits}
    checks = {name: judged._asdict() for name, judged in tuned.checks.items()}
    how = {"method": str(problem.plan.method), "steps_per_period": problem.plan.steps_per_period}
    robust = {} if tuned.robust is None else {"robust": tuned.robust}
    return plain({**told, **asked, **how, **robust, "checks": checks, "map": drawn, **search, **_attrs(scene_file)})


def trade_json(found: Sequence[Measured], scene_file: SceneFile) -> dict[str, Any]:
    """Measured settings as `trade.json` holds them."""
    kept = front(found)
    rows = [
        {
            "setting": str(m.setting),
            "kind": m.setting.kind,
            "steps_per_period": m.steps,
            "cost": m.cost,
            "state_error": error_of(m),
            "state_error_median": np.nanmedian(m.state),
            **{name: getattr(m, name) for name in ("P_d", "ci", "period", "gradient")},
            "front": i in kept,
        }
        for i, m in enumerate(found)
    ]
    return plain({"settings": rows, "horizon": HORIZON, **_attrs(scene_file)})


def _attrs(scene_file: SceneFile) -> dict[str, Any]:
    return {
        "title": scene_file.title,
        "scene": scene_file.text(),
        "source": scene_file.name,
        "version": __version__,
    }
