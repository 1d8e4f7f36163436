"""How much clocks of their own for clusters of touching blades could save: python tests/benchmarks/row_clusters.py.

In the march of a row every event of any interface costs a trial of all N blades. With clocks for clusters it would
cost a trial of the blades of its cluster. The script counts both in real motions, from fine samples: N (steps + events)
against N steps + the sum over the events of the size of the cluster. The gain is the largest possible: meetings of
clusters, which would have to be searched for, are free here.
"""

import json
from pathlib import Path
from typing import NamedTuple

import jax
import numpy as np
from rich.console import Console
from rich.table import Table

import jaxshroud as js
from jaxshroud.model.modes import Mode

RESULTS = Path(__file__).parent / "results"
STEPS = 100  # of the march that is judged


class Kind(NamedTuple):
    """A motion: its overrides, the numbers of blades, and the run in which its events are counted."""

    sets: list[str]
    blades: tuple[int, ...] = (4, 8, 12, 32)
    transient: int = 8
    periods: int = 4
    steps: int = 1600


KINDS = {
    "gap, in resonance": Kind(["contact.gamma=1.0", "drive.omega=1118"]),
    "gap": Kind(["contact.gamma=2.5"]),
    "interference": Kind(["contact.gamma=2.5", "shroud.gap=-0.4 mm"]),
    "light blocks": Kind(["blades.I=block", "drive.M_0=0.3", "contact.gamma=2.6"], (4, 8, 12), 1, 1, 3200),
}


def cluster_sizes(touches: np.ndarray) -> np.ndarray:
    """The blades in the cluster of each interface of a ring, or of the two blades beside it (samples, N)."""
    n = touches.shape[1]
    sizes = np.empty(touches.shape, int)
    for at, row in enumerate(touches):
        if row.all():
            sizes[at] = n
            continue
        order = np.roll(np.arange(n), -(1 + int(np.flatnonzero(~row)[0])))
        runs = np.split(order, 1 + np.flatnonzero(~row[order]))  # each ends with an interface that is apart
        for run in runs:
            sizes[at, run] = len(run)
    return sizes


def gain_of(blades: int, kind: Kind) -> dict[str, float]:
    """The events of a period and a blade, the mean size of their clusters, and the gain that is possible."""
    row = [f"row.blades={blades}", "row.closed=true", f"drive.engine_order={blades // 4}"]
    scene = js.load("table1", row + kind.sets).scene
    method = js.RungeKutta("dopri8", steps=kind.steps)
    run = js.simulate(scene, n_periods=kind.transient + kind.periods, method=method)
    late = slice(-kind.periods * kind.steps - 1, None)
    mode, case = np.asarray(run.mode)[late], np.asarray(run.case)[late]
    changes = (np.diff(mode, axis=0) != 0) | (np.diff(case, axis=0) != 0)
    touches = (mode != Mode.APART)[1:] | (mode != Mode.APART)[:-1]
    events = changes.sum() / kind.periods
    own = cluster_sizes(touches)[changes].sum() / kind.periods
    return {
        "blades": blades,
        "events": events / blades,
        "cluster": own / events if events else 0.0,
        "touching": touches.mean(),
        "gain": blades * (STEPS + events) / (blades * STEPS + own),
    }


def main() -> None:
    """Print the table and write `results/row_clusters.json`."""
    jax.config.update("jax_enable_x64", True)
    found, console = {}, Console(width=110)
    for name, kind in KINDS.items():
        rows = [gain_of(blades, kind) for blades in kind.blades]
        table = Table("blades", "events / blade", "blades in the cluster", "touching", "gain at most", title=name)
        for row in rows:
            cells = f"{row['events']:.1f}", f"{row['cluster']:.1f}", f"{row['touching']:.2f}", f"{row['gain']:.2f}"
            table.add_row(str(row["blades"]), *cells)
        console.print(table)
        found[name] = rows
    (RESULTS / "row_clusters.json").write_text(json.dumps(found, indent=1) + "\n", "utf-8")


if __name__ == "__main__":
    main()
