"""Which reduction counts where blades are pressed or bent at rest."""

import jaxshroud as js
from jaxshroud.signals.amplitudes import counted_reduction


def test_a_mean_load_or_interference_makes_the_vibration_count():
    counted = lambda *changes: counted_reduction(js.load("table1", list(changes)).scene)
    assert counted() == "P_d"
    assert counted("drive.F_x_mean=0") == "P_d"
    assert counted("drive.F_x_mean=[0, 1]") == "P_d_vibration"
    assert counted("drive.M_mean=0.1") == "P_d_vibration"
    assert counted("shroud.gap=-1 um") == "P_d_vibration"
    assert counted("shroud.gap=-1 um", "parts.contact=none") == "P_d"
    ring = ("drive.phase=0", "row.blades=3", "shroud.gap=[1e-5, -1e-6]")
    assert counted(*ring) == "P_d_vibration"
