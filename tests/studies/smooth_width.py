"""At which power of its width does smooth contact converge? python tests/studies/smooth_width.py

One drive period from rest of 16 stiffness ratios of four scenes, with friction and without: the difference from the
spring law with located events (Dormand-Prince 8, 2,000 steps), relative to the size of each quantity, for three widths
that are shares of the gap. `smooth_width.json` has the median over the stiffness ratios for each width, the slope of a
line through their logarithms, and the quartiles of the slopes of single stiffness ratios.
"""

import json
import sys
from pathlib import Path
from typing import Any

import jax
import numpy as np

jax.config.update("jax_enable_x64", True)

sys.path.insert(0, str(Path(__file__).parents[1]))

from side_by_side import EXACT, ends, relative_error, run, sizes, with_parts  # noqa: E402

import jaxshroud as js  # noqa: E402
from jaxshroud.march.method import FAST_WITH_LEDGER  # noqa: E402
from jaxshroud.march.stability import largest_frequency  # noqa: E402

SCENES = {"table1": 8.0, "fig09_best": 8.0, "table1_light": 8.0, "fig16_best": 30.0}  # largest stiffness ratio
SHARES = (0.15, 0.05, 0.015)  # of the gap
LANES, SAFE = 16, 0.5  # largest phase of the fastest oscillation in a step


def errors(name: str, friction: str, lanes: int = LANES, shares: tuple[float, ...] = SHARES) -> np.ndarray:
    """Differences from the spring law, (widths, lanes)."""
    scene = js.load(name).scene
    scenes = [js.vary(scene, "contact.gamma", gamma) for gamma in np.linspace(0.5, SCENES[name], lanes)]
    exact = run([with_parts(one, friction=friction) for one in scenes], 1, 2000, EXACT["dopri8-cubic"])
    found = []
    for share in shares:
        width = share * float(scene.shroud.gap)
        smooth = [with_parts(one, width, contact="smooth", friction=friction) for one in scenes]
        fastest = max(float(largest_frequency(one)) for one in smooth)
        got = run(smooth, 1, int(np.ceil(fastest * float(scene.drive.period) / SAFE)), FAST_WITH_LEDGER)
        assert not np.any(got.last.status), name
        found.append(relative_error(ends(got), ends(exact), np.maximum(sizes(exact), 1e-30)))
    return np.array(found)


def order(found: np.ndarray, shares: tuple[float, ...] = SHARES) -> dict[str, Any]:
    """What comes of differences (widths, lanes)."""
    slopes = np.polyfit(np.log(shares), np.log(found), 1)[0]
    median = np.median(found, axis=1)
    return {
        "median": [float(f"{one:.3g}") for one in median],
        "order": round(float(np.polyfit(np.log(shares), np.log(median), 1)[0]), 2),
        "quartiles": [round(float(q), 2) for q in np.percentile(slopes, (25, 75))],
    }


def main() -> None:
    """All scenes."""
    out: dict[str, Any] = {"command": "python tests/studies/smooth_width.py", "version": js.__version__}
    out |= {"widths over gap": SHARES, "stiffness ratios": LANES}
    for name in SCENES:
        out[name] = {friction: order(errors(name, friction)) for friction in ("none", "bilinear")}
        print(name, json.dumps(out[name]), flush=True)
    Path(__file__).with_suffix(".json").write_text(json.dumps(out, indent=1) + "\n", "utf-8")


if __name__ == "__main__":
    main()
