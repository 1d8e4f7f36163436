"""Devices of one machine share the lanes, and say nothing of the numbers."""

import os
import subprocess
import sys

import pytest

# A sweep of four chunks on one of two devices, then on both.
SCRIPT = """
import jax
import numpy as np

jax.config.update("jax_enable_x64", True)
import jaxshroud as js
from jaxshroud.batch import stepped_runs

used, run_block = set(), stepped_runs.run_block

def told(*arguments):
    end, *rest = run_block(*arguments)
    used.update(device.id for device in end.lanes.status.devices())
    return end, *rest

stepped_runs.run_block = told
scene = js.load("table1", ['parts.motion=["x"]']).scene
found = {}
for name, device in {"one": jax.devices()[1], "all": None}.items():
    used.clear()
    with jax.default_device(device):
        line = {"contact.gamma": np.linspace(1.0, 2.0, 200)}
        found[name] = js.sweep(scene, line, n_periods=2, transient=1, method=js.RungeKutta(steps=100)).data
    print(name, *sorted(used))
assert found["one"].identical(found["all"])
for name, variable in found["one"].variables.items():
    assert variable.to_numpy().tobytes() == found["all"][name].to_numpy().tobytes(), name
assert set(found["all"].status.to_numpy()) == {js.Status.OK}
"""


@pytest.mark.release
@pytest.mark.full
def test_two_devices_find_the_bits_of_one():
    flags = f"{os.environ.get('XLA_FLAGS', '')} --xla_force_host_platform_device_count=2"
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT],
        capture_output=True,
        text=True,
        timeout=600,
        env=os.environ | {"XLA_FLAGS": flags},
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.split("\n")[:2] == ["one 1", "all 0 1"]  # both had their part
