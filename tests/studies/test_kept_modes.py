"""How many modes are enough where blades rub: the stored answers, and three modes anew."""

import json

import kept_modes
import numpy as np
import pytest

pytestmark = pytest.mark.studies
STORED = json.loads(kept_modes.FILE.read_text("utf-8"))
ERRORS = ("error of the power", "error of x_peak")


def test_residual_vectors_carry_what_modes_leave_out():
    for error in ERRORS:
        plain, whole = (
            [STORED[f"{count} modes{further}"][error] for count in kept_modes.KEPT]
            for further in ("", " and residual vectors")
        )
        assert plain == sorted(plain, reverse=True)
        assert all(b < a / 9 for a, b in zip(plain, whole, strict=True))
    assert [STORED[f"{count} modes and residual vectors"][ERRORS[1]] for count in kept_modes.KEPT] == sorted(
        (STORED[f"{count} modes and residual vectors"][ERRORS[1]] for count in kept_modes.KEPT), reverse=True
    )


def test_three_modes_are_as_near_as_stored():
    P_d, x_peak = (np.array(STORED["reference"][name]) for name in ("P_d", "x_peak"))
    found = kept_modes.by_modes(3, residuals=True)
    assert found["period"] == [1] * 5
    assert np.max(np.abs((found["P_d"] - P_d) / (100 - P_d))) < 1e-4
    assert np.max(np.abs(found["x_peak"] / x_peak - 1)) < 2e-4
