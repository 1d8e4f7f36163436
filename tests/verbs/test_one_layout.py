"""A chain of two gives what the pair gives: the same variables, with an axis of its only interface."""

import pytest
import xarray as xr

import jaxshroud as js

LIGHT = ['parts.motion=["x"]', "blades.c_x=40"]
PAIR = js.load("table1", [*LIGHT, 'blades.I="block"', "drive.F_0=60", "drive.M_0=0.3"]).scene
CHAIN = js.load("row_ring12", [*LIGHT, "row.blades=2", "row.closed=false", "drive.engine_order=1"]).scene
HOW = {"method": js.RungeKutta("rk4", steps=100)}
SHORT = {**HOW, "n_periods": 4, "transient": 4}
SCENES_BY_GAP = {"shroud.gap": [2e-5, 3e-5]}
VERBS = {
    "simulate": lambda scene: js.simulate(scene, n_periods=2, **HOW),
    "sweep": lambda scene: js.sweep(scene, SCENES_BY_GAP, forces=True, amplitudes=True, **SHORT),
    "power": lambda scene: js.power(scene, forces=True, amplitudes=True, **SHORT),
    "orbit": lambda scene: js.orbit(scene, **HOW),
    "branch": lambda scene: js.branch(scene, "drive.omega", 900.0, 901.0, at=900.5, most_points=3, **HOW),
    "gradient": lambda scene: js.gradient(scene, ["shroud.gap"], **HOW),
    "table": lambda scene: js.table(scene, {"shroud.gap": [2e-5, 3e-5]}, **SHORT),
    "diagnose": lambda scene: js.diagnose(scene, transient=16, **HOW),
}
# What is told of each blade or interface of a row; runs of a pair keep loads where `forces` asks for them.
OF_ROWS = {
    "P_d_worst",
    "final_P_d_worst",
    "interface_v_max",
    "blade_work_drive",
    "blade_loss_viscous",
    *("P", "P_0"),
    *("slip", "N_mean", "N_slip"),
}

# What a pair alone has: equivalents of contact, states at events, and a verdict by tangents.
EQUIVALENTS = {"k_n", "k_t", "c_n", "c_t", "zeta_n", "zeta_t", "P_d_stiffness", "touches"}
OF_PAIRS = {"exponents", "exponents_ci", "multipliers_real", "multipliers_imag", *EQUIVALENTS}


def shapes(data: xr.Dataset) -> dict[str, tuple[str, ...]]:
    """The dimensions of all numbers, without that of interfaces."""
    of = {str(name): tuple(str(d) for d in v.dims if d != "interface") for name, v in data.data_vars.items()}
    return of | {name: () for name, value in data.attrs.items() if not isinstance(value, str)}


@pytest.mark.full
@pytest.mark.parametrize("verb", VERBS)
def test_a_chain_of_two_has_the_variables_of_the_pair(verb):
    pair, chain = (VERBS[verb](scene).to_xarray() for scene in (PAIR, CHAIN))
    of_pair, of_chain = shapes(pair), shapes(chain)
    assert of_chain.keys() - of_pair.keys() <= OF_ROWS
    assert {name for name in of_pair.keys() - of_chain.keys() if not name.startswith("event_")} <= OF_PAIRS
    common = of_pair.keys() & of_chain.keys()
    assert {name: of_chain[name] for name in common} == {name: of_pair[name] for name in common}
