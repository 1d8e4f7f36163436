"""Results as labelled datasets and as plain numbers, for files."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import xarray as xr

from jaxshroud.model.modes import Mode, Status
from jaxshroud.results.gradient import Gradient
from jaxshroud.results.power import PowerResult
from jaxshroud.results.store import plain
from jaxshroud.results.sweep import SweepResult
from jaxshroud.results.trajectory import Trajectory
from jaxshroud.scene.config import SceneFile
from jaxshroud.scene.keys import KEYS, rows_of
from jaxshroud.scene.motion import Motion
from jaxshroud.verbs.setting import HORIZON
from jaxshroud.verbs.trade import Measured, error_of, front
from jaxshroud.verbs.tune import Tuned
from jaxshroud.version import __version__

MOTION_ATTRS = {row.parts[1]: (row.netcdf, row.about) for row in rows_of("initial")}
UNITS = {row.name: row.netcdf for row in KEYS.values()}
STATUS = {"flag_values": [int(s) for s in Status], "flag_meanings": " ".join(s.name for s in Status)}
MODE = {"flag_values": [int(m) for m in Mode], "flag_meanings": " ".join(m.name for m in Mode)}


def dimension(key: str) -> str:
    """Name of the dimension along `key`: its last word, but `initial_x` where a variable has that name."""
    table, name = key.split(".")
    stem, _, blade = name.partition("[")
    stem = f"{table}_{stem}" if stem in MOTION_ATTRS or stem in ("period", "blade") else stem
    return stem + {"": "", "0]": "_left", "1]": "_right"}[blade]


def sweep_dataset(result: SweepResult, scene_file: SceneFile) -> xr.Dataset:
    """A sweep as a dataset: dimensions of its axes, then `period` and `blade`."""
    dims = [dimension(key) for key in result.axes]
    lane = lambda values, **attrs: (dims, values, attrs)  # noqa: E731
    data: dict[str, Any] = {
        name: ([*dims, "period", "blade"], getattr(result.motion, name), _named(*MOTION_ATTRS[name]))
        for name in Motion._fields
    }
    data |= {
        "P": ([*dims, "blade"], result.P, _named("m4", "average power, Eq. (23)")),
        "P_0": ([*dims, "blade"], result.P_0, _named("m4", "average power without contact, closed form")),
        "P_d": lane(result.P_d, **_named("percent", "vibration-power reduction of the left blade, Eq. (24)")),
        "P_d_ci": lane(result.P_d_ci, **_named("percent", "half width of the 95 % interval of P_d, batch means")),
        "P_d_ci_short": lane(result.P_d_ci_short.astype(np.int8), long_name="too few correlation times for P_d_ci"),
        "P_d_settled": lane(result.P_d_settled.astype(np.int8), long_name="P_d no longer drifts, on evidence"),
        "P_d_settling": lane(result.P_d_settling, **_verdict("P_d no longer drifts")),
        "P_d_periods_more": lane(result.P_d_periods_more, **_more("P_d no longer drifts")),
        "period_number": lane(result.period_number, long_name="period of the orbit in drive periods; 0: aperiodic"),
        "settled": lane(result.settled.astype(np.int8), long_name="the transient is over, on evidence"),
        "settling": lane(result.settling, **_verdict("the transient is over")),
        "periods_more": lane(result.periods_more, **_more("it is over")),
        "status": lane(result.status.astype(np.int8), **STATUS),
        "v_max": lane(result.v_max, **_named("m", "largest penetration")),
    }
    data |= {
        name: lane(getattr(result, name), **_named("1", f"fraction of the time: {name[5:]}"))
        for name in ("time_apart", "time_stick", "time_slip")
    }
    if result.energy_residual is not None:
        text = "largest energy residual of a period over the drive's mean work"
        data["energy_residual"] = lane(result.energy_residual, **_named("1", text))
    if result.energy_dropped is not None:
        text = "largest energy dropped in a period by beginnings of flat contact, over the drive's gross work"
        data["energy_dropped"] = lane(result.energy_dropped, **_named("1", text))
    data |= {name: lane(n, long_name=f"events in the kept periods: {name}") for name, n in result.counters.items()}
    coords: dict[str, Any] = {
        dim: (dim, values, {"key": key, "units": UNITS.get(key.partition("[")[0], "1"), "long_name": key})
        for dim, (key, values) in zip(dims, result.axes.items(), strict=True)
    }
    if "gap" not in dims:
        data["gap"] = lane(result.gap, **_named("m", "initial gap"))
    coords |= {
        "period": ("period", result.period, {"long_name": "drive periods since t = 0"}),
        "blade": [0, 1],
    }
    attrs = _attrs(scene_file) | {
        "axes": ",".join(dims),
        "drive_phase": float(result.phase),
        "period_tol": float(result.period_tol),
        "steps_per_period": result.steps_per_period,
        "method": str(result.method),
        "complete": int(result.complete),
    }
    return xr.Dataset(data, coords, attrs)


def trajectory_dataset(run: Trajectory, scene_file: SceneFile, steps_per_period: int, every: int) -> xr.Dataset:
    """A trajectory as a dataset with dimensions `time` and `blade`."""
    data: dict[str, Any] = {
        name: (["time", "blade"], getattr(run.motion, name), _named(*MOTION_ATTRS[name])) for name in Motion._fields
    }
    data |= {
        "u_s": ("time", run.u_s, _named("m", "slider of the friction element; NaN when apart")),
        "mode": ("time", run.mode.astype(np.int8), {"long_name": "contact mode", **MODE}),
        "case": (
            "time",
            run.case.astype(np.int8),
            {"long_name": "contact case 1-4 of Sec. 2.3; 5: face to face; 0 when apart"},
        ),
    }
    scene = scene_file.scene
    attrs = _attrs(scene_file) | {
        "status": run.status,
        **STATUS,
        **{f"count_{name}": n for name, n in run.counters.items()},
        "energy_residual": run.energy_residual,
        "energy_dropped": run.energy_dropped,
        "omega": float(scene.drive.omega),
        "gap": float(scene.shroud.gap),
        "steps_per_period": steps_per_period,
        "every": every,
        "end_turns": run.turns,
    }
    return xr.Dataset(data, {"time": ("time", run.t, _named("s", "time")), "blade": [0, 1]}, attrs)


def power_json(result: PowerResult, scene_file: SceneFile) -> dict[str, Any]:
    """A power convergence as plain numbers."""
    curve = {name: getattr(result, name).tolist() for name in ("n", "P_d", "P_d_ci")}
    return {**_attrs(scene_file), **curve, "final": result.final}


def gradient_json(found: Gradient, scene_file: SceneFile) -> dict[str, Any]:
    """A gradient as `gradient.json` holds it."""
    at = found.orbit
    told = {n: getattr(found, n) for n in ("of", "kind", "value", "ci", "level", "level_ci", "sigma", "flags")}
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
    return plain({**told, **asked, **how, "checks": checks, "map": drawn, **search, **_attrs(scene_file)})


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


def _named(units: str, long_name: str) -> dict[str, str]:
    return {"units": units, "long_name": long_name}


def _verdict(what: str) -> dict[str, Any]:
    return {"long_name": what, "flag_values": [0, 1, 2], "flag_meanings": "no yes unknown"}


def _more(until: str) -> dict[str, str]:
    return _named("1", f"drive periods of transient to add until {until}; NaN if unknown")


def _attrs(scene_file: SceneFile) -> dict[str, Any]:
    return {
        "title": scene_file.title,
        "scene": scene_file.text(),
        "source": scene_file.name,
        "version": __version__,
    }
