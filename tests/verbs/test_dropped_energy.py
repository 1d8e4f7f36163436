"""The energy that beginnings of flat contact drop has one measure: the gross work of the drive."""

import numpy as np
import pytest

import jaxshroud as js
from jaxshroud.cli.runs import energy_rows

pytestmark = pytest.mark.full

# Rocking that would return within a fiftieth of a period counts as flat, which drops its energy.
COARSE = js.RungeKutta(steps=200, flat_return=1 / 50)


@pytest.fixture(scope="module")
def light():
    return js.load("table1_light", ["drive.M_0=0.3"]).scene


def test_power_and_sweep_tell_the_same_drop_over_gross_work(light):
    run = {"n_periods": 16, "transient": 8, "method": COARSE}
    swept = js.sweep(light, {"contact.gamma": [2.6]}, ledger=True, **run)
    found = js.power(js.vary(light, "contact.gamma", 2.6), stable_within=1e-12, **run)
    assert found.final["energy_dropped"] > 1e-8
    # The same march in parts: the sums differ by rounding alone.
    np.testing.assert_allclose(found.final["energy_dropped"], swept.energy_dropped[0], rtol=1e-9)


def test_a_diagnosis_tells_the_drop(light):
    found = js.diagnose(light, transient=8, method=COARSE)
    assert found.energy_dropped > 0
    assert energy_rows(found)["energy dropped"].startswith(f"{found.energy_dropped:.1e} of the drive's gross work")
