"""Reference runs of rows of blades for the study `unchanged`: all verbs that take rows."""

from collections.abc import Callable, Iterator
from typing import Any

import jax
import numpy as np
from reference_runs import Given, Run, Values, rows, text

import jaxshroud as js

CHAIN = ("row_chain5",)
RING = ("row_ring12", "row.blades=4", "drive.engine_order=1")
PAIR_OF_ROW = ("row_ring12", "row.blades=2", "row.closed=false", "drive.engine_order=0")
BENDING = 'parts.motion=["x", "y"]'
SCENES = {
    "chain": CHAIN,
    "ring": RING,
    "chain of two": PAIR_OF_ROW,
    "mistuned ring": (*RING, "row.mistuning=[0.02, -0.01, 0.03, 0.0]"),
    "light, M_0 0.1": (*RING, "drive.M_0=0.1", "drive.F_0=30"),
    "flat": (*RING, "drive.M_0=0", "blades.I=2.5e-5"),
    "stuck": (*RING, "friction.mu=5", "shroud.gap=-5 um", BENDING),
    "apart": (*RING, "shroud.gap=4 mm"),
}
COARSE = js.RungeKutta("dopri8", steps=160)
SHORT: dict[str, Any] = {"n_periods": 4, "transient": 4, "method": COARSE}
Does = Callable[[Given], Values]


def told(result: Any, *names: str) -> Values:
    """Quantities of a result: real and complex numbers as a row, whole numbers as they are, words as numbers."""
    return {name: _array(getattr(result, name)) for name in names}


def _array(value: Any) -> np.ndarray:
    """One quantity of a result."""
    if isinstance(value, str):
        return text(value)
    array = np.asarray(value)
    if array.dtype.kind in "biu":
        return array
    return rows(np.abs(array) if array.dtype.kind == "c" else array.astype(float))


def simulated(scene: tuple[str, ...], given: Given, periods: int = 2) -> Values:
    """What `simulate` gives of a row."""
    came = js.simulate(given.scene(*scene), n_periods=periods, method=COARSE, every=40)
    counts = np.stack([np.asarray(count) for count in came.counters.values()])
    works = told(came, "loss_friction", "N_mean", "x_peak", "y_rms")
    works |= {"work_drive": rows(came.blade_work_drive), "loss_viscous": rows(came.blade_loss_viscous)}
    works |= {"slip": rows(periods * came.slip)}
    times = told(came, "time_apart", "time_stick", "time_slip")
    contact = told(came, "N", "F", "v", "u", "mode", "case", "status")
    return {"motion": rows(*came.motion), "events": counts, **works, **times, **contact}


def simulations() -> Iterator[Run]:
    """Rows of all kinds, few periods from rest."""
    for name, scene in SCENES.items():
        does = lambda given, scene=scene: simulated(scene, given)
        yield Run("rows, simulate", name, "few periods", does)


def swept(given: Given) -> Values:
    """What `sweep` gives of the gap and the moment of a ring."""
    along = {"shroud.gap[1]": (1e-5, 3e-5), "drive.M_0": (0.1, 1.0)}
    came = js.sweep(given.scene(*RING), along, **SHORT, ledger=True, amplitudes=True)
    names = ("P", "P_0", "P_d", "P_d_vibration", "period_number", "status", "settling", "x_peak", "energy_residual")
    return {"motion": rows(*came.motion), **told(came, *names, "time_apart", "time_stick", "time_slip")}


def averaged(given: Given) -> Values:
    """What `power` gives of a chain."""
    came = js.power(given.scene(*CHAIN), **{**SHORT, "n_periods": 8})
    return {"P_d": rows(came.P_d[-1]), **told(came, "status")}


def in_function(given: Given) -> Values:
    """What `sweep_function` gives of two rings, with a derivative by the gaps."""
    scene = given.scene(*RING, BENDING)
    scenes = js.stack_scenes([js.vary(scene, "drive.F_0", force) for force in (40.0, 60.0)])
    run = js.sweep_function(n_periods=2, transient=2, method=js.RungeKutta("dopri8", steps=160))
    came = jax.jit(run)(scenes)
    return {name: _array(getattr(came, name)) for name in ("P", "P_d", "P_d_vibration", "status")}


def with_tangents(given: Given) -> Values:
    """The derivative of P_d of a ring on its orbit."""
    came = js.gradient(given.scene(*RING, BENDING), ["shroud.gap", "friction.mu", "drive.F_0[2]"], method=COARSE)
    return {"value": np.array([[v] for v in came.value.values()]), **told(came, "level", "kind")}


def closed(given: Given) -> Values:
    """What `orbit` gives of a ring."""
    came = js.orbit(given.scene(*RING, BENDING), method=COARSE, tolerance=1e-11, most_periods=256)
    start = {"start": rows(*came.start.motion), "slider": rows(came.start.u_s)}
    names = ("P", "P_0", "P_d", "P_d_vibration", "q", "multipliers", "wave_parts", "wave_multipliers")
    return {**start, **told(came, *names)}


def followed(given: Given) -> Values:
    """What `branch` gives of a chain of two, over a short range."""
    came = js.branch(given.scene(*PAIR_OF_ROW, BENDING), "drive.F_0", 60.0, 64.0, method=COARSE, most_points=12)
    return told(came, "P_d", "q", "x_peak")


def diagnosed(scene: tuple[str, ...], given: Given) -> Values:
    """What `diagnose` gives of a ring."""
    came = js.diagnose(given.scene(*scene), transient=32, method=COARSE)
    return told(came, "verdict", "period_number", "P_d_vibration", "x_peak", "energy_residual")


def mistuned(given: Given) -> Values:
    """What `mistune` gives of a few patterns of a ring."""
    came = js.mistune(given.scene(*RING, BENDING), {"drive.omega": (500.0, 540.0)}, n_patterns=4, scan=4, **SHORT)
    return told(came, "amplification", "x_peak") if hasattr(came, "x_peak") else told(came, "amplification")


def tabulated(given: Given) -> Values:
    """What `table` gives of four designs of a ring."""
    designs = {"shroud.gap": [1e-5, 2e-5, 3e-5, 4e-5], "friction.mu": [0.3, 0.3, 0.6, 0.6]}
    came = js.table(given.scene(*RING, BENDING), designs, **SHORT)
    numbers = (name for name, values in came.data.data_vars.items() if values.dtype.kind in "fiub")
    return {name: _array(came.data[name].to_numpy()) for name in sorted(map(str, numbers))}


def reported(given: Given) -> Values:
    """Numbers of a data sheet of a ring that never touches."""
    came = js.report(given.scene(*SCENES["apart"]), n_periods=4, transient=8, method=COARSE, starts=2, draws=2)
    told = came.summary()["diagnosis"]
    return {"verdict": text(told["verdict"]), "x_peak": rows(told["x_peak"]), "P": rows(told["P"], told["P_0"])}


def responding(given: Given) -> Values:
    """What `response` gives of a ring, by the motions that settle."""
    came = js.response(given.scene(*RING, BENDING), "drive.omega", 500.0, 540.0, num=3, **SHORT)
    return {name: _array(came.data[name].to_numpy()) for name in ("x_peak", "P_d") if name in came.data}


def rolled(given: Given) -> Values:
    """What `rollout` gives of a ring."""
    came = js.rollout(given.scene(*RING), n_periods=2, every=40, method=COARSE)
    return {"motion": rows(*came.saved.state.motion), "N": rows(came.saved.N), **told(came, "power", "events")}


VERBS: dict[str, tuple[str, Does]] = {
    "sweep": ("few periods", swept),
    "power": ("few periods", averaged),
    "sweep_function": ("few periods", in_function),
    "rollout": ("few periods", rolled),
    "tangents": ("derivative", with_tangents),
    "orbit": ("derivative", closed),
    "branch": ("derivative", followed),
    "diagnose": ("settled", lambda given: diagnosed((*RING, BENDING), given)),
    "diagnose, apart": ("settled", lambda given: diagnosed(SCENES["apart"], given)),
    "mistune": ("few periods", mistuned),
    "table": ("few periods", tabulated),
    "report": ("settled", reported),
    "response": ("few periods", responding),
}


def verbs() -> Iterator[Run]:
    """The verbs that take rows."""
    for name, (rule, does) in VERBS.items():
        yield Run("rows, verbs", name, rule, does)


def row_runs() -> list[Run]:
    """All of them, by groups."""
    return [*simulations(), *verbs()]
