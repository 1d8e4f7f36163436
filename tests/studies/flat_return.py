"""What is the share of a period worth within which rocking faces become flat? python tests/studies/flat_return.py

Table 1 with light blocks and a small moment (I = 3e-5 kg m^2, M_0 = 0.5 N m) at 40 values of gamma, three periods from
rest by Dormand-Prince 8, against 3,200 steps with a share of 1/614400. What is told: the errors of the states and the
CPU time, the least of three runs over that of the first line. Beyond 1/24 of a step shares make no difference.
`flat_return.json` has the table.
"""

import json
import time
from pathlib import Path

import jax
import numpy as np

jax.config.update("jax_enable_x64", True)

import jaxshroud as js  # noqa: E402
from jaxshroud.march.method import choices  # noqa: E402
from jaxshroud.orbits.short_runs import end_states, state_errors  # noqa: E402

SHARES, STEPS, FINEST = (1 / 2400, 1 / 9600, 1 / 38400, 1 / 153600), (200, 800), 1 / 614400
SCENE = js.load("table1", ["blades.I=3e-5", "drive.M_0=0.5"]).scene
SCENES = js.scenes_from({"contact.gamma": np.linspace(0.5, 6.0, 40)}, SCENE)


def timed(steps: int, share: float, times: int) -> tuple[np.ndarray, float]:
    """The states at the end, and the least CPU time [s]."""
    method, least = choices(js.RungeKutta("dopri8", steps, flat_return=share)), np.inf
    states = end_states(SCENES, steps, method).motions
    for _ in range(times):
        start = time.process_time()
        end_states(SCENES, steps, method)
        least = min(least, time.process_time() - start)
    return states, least


def main() -> None:
    """All shares and steps."""
    exact, _ = timed(4 * STEPS[-1], FINEST, 0)
    lines = []
    for steps in STEPS:
        for share in SHARES:
            states, seconds = timed(steps, share, 3)
            error = state_errors(states, exact)
            told = {"steps": steps, "share": f"1/{round(1 / share)}", "median": float(np.median(error))}
            lines.append({**told, "95 %": float(np.quantile(error, 0.95)), "CPU": seconds})
    for line in lines[::-1]:
        line["CPU"] = round(line["CPU"] / lines[0]["CPU"], 2)
    for line in lines:
        print(line, flush=True)
    command = "python tests/studies/flat_return.py"
    Path(__file__).with_suffix(".json").write_text(json.dumps({"command": command, "lines": lines}, indent=1) + "\n")


if __name__ == "__main__":
    main()
