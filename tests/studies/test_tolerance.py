"""A sample of the study of tolerances."""

import pytest
import tolerance

pytestmark = pytest.mark.studies


@pytest.mark.release
def test_what_is_said_of_a_design_holds():
    # Bending only, with regular motion: nothing between the values that were looked at loses more.
    tuned, own, how = tolerance.tuned_design("bending only, two loads, a limit of force")
    found = tolerance.interval_judged(tuned, own, how, 0, "contact.gamma")
    assert found["lose more"] == 0
    assert found["swept"] >= 10 * 32
    assert found["lose more beyond"] == len(found["beyond"]) == 2
    # 512 against 2,000 draws: once in a thousand by chance.
    assert tolerance.probability_judged(tuned, own, how, seed=7, seeds=1)["p of Fisher's test"] > 1e-3
