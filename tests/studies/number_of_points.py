"""Faces of 2, 3, 5 and 9 points against the article's corner: python tests/studies/number_of_points.py

Scenes of pairs and `row_ring12` are swept along gamma by the corner and by points. What is told of each value: P_d,
the period number, and events a drive period; and of each model its cost, CPU time a lane and period of a second sweep
in the same process, side by side with the others, with the error of the displacements after three periods from rest
against eight times as many steps. It writes `number_of_points.json`; with `--draw` the pictures of docs/points.md are
drawn from that.
"""

import argparse
import json
from pathlib import Path
from time import process_time
from typing import Any

import jax
import numpy as np

import jaxshroud as js

FILE = Path(__file__).with_suffix(".json")
PICTURES = Path(__file__).parent.parent.parent / "docs" / "pictures"
MODELS = {"corner": None, "2 points": 2, "3 points": 3, "5 points": 5, "9 points": 9}
SCENES = {  # name -> the shipped scene, changes, values of gamma, transient and kept periods
    "fig09_best": ("fig09_best", [], np.linspace(0.5, 8.0, 24), (200, 48)),
    "table1_light": ("table1_light", ["drive.M_0=0.3"], np.linspace(0.5, 8.0, 24), (200, 48)),
    "table1": ("table1", [], np.linspace(0.5, 8.0, 24), (200, 48)),
    "row_ring12": ("row_ring12", ["blades.I=block", "drive.M_0=0.3"], np.linspace(1.0, 5.5, 4), (60, 16)),
}
STEPS, FINER = 400, 8
HORIZON = 3  # drive periods from rest, after which errors are taken


def swept(scene: js.Scene, gammas: np.ndarray, transient: int, kept: int, steps: int = STEPS) -> js.SweepResult:
    """One scene along gamma."""
    method = js.RungeKutta("rk4", steps=steps)
    return js.sweep(scene, {"contact.gamma": gammas}, n_periods=kept, transient=transient, method=method)


def figures(name: str, points: int | None) -> dict[str, Any]:
    """What is told of one scene with one model of its faces."""
    shipped, changes, gammas, (transient, kept) = SCENES[name]
    with_points = [] if points is None else [f"contact.points={points}"]
    scene = js.load(shipped, [*changes, *with_points]).scene
    swept(scene, gammas, 1, 2)  # compiles
    begin = process_time()
    found = swept(scene, gammas, transient, kept)
    seconds = process_time() - begin
    last = lambda steps: np.stack(swept(scene, gammas, HORIZON - 1, 1, steps).motion, axis=1)[..., -1, :]
    ends = last(STEPS), last(STEPS * FINER)
    size = np.abs(ends[1]).max(axis=(0, 2), keepdims=True)
    errors = np.abs((ends[0] - ends[1]) / size).max(axis=(1, 2))
    per_period = {kind: np.asarray(count, float) / kept for kind, count in found.counters.items()}
    if scene.row is not None:
        per_period = {kind: count.mean(axis=-1) if count.ndim > 1 else count for kind, count in per_period.items()}
    return {
        "gamma": gammas.tolist(),
        "P_d": np.asarray(found.P_d).tolist(),
        "period": np.asarray(found.period_number).tolist(),
        "status": np.asarray(found.status).tolist(),
        "events": {kind: count.tolist() for kind, count in per_period.items()},
        "microseconds": 1e6 * seconds / (len(gammas) * (transient + kept)),
        "error": {"median": float(np.median(errors)), "p90": float(np.quantile(errors, 0.9))},
    }


def draw(found: dict[str, dict[str, Any]]) -> None:
    """The pictures: P_d, and events a period, along gamma."""
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    from jaxshroud.plotting.style import STYLE

    with plt.rc_context(STYLE):
        for name, by_model in found.items():
            figure, (power, events) = plt.subplots(1, 2, figsize=(7.0, 2.6), layout="constrained")
            for i, model in enumerate(MODELS):
                if model not in by_model:
                    continue
                one = by_model[model]
                total = np.sum([*one["events"].values()], axis=0)
                style = {"color": "#222222", "lw": 1.4} if model == "corner" else {"color": f"C{i - 1}", "lw": 0.9}
                power.plot(one["gamma"], one["P_d"], label=model, **style)
                events.plot(one["gamma"], total, label=model, **style)
            power.set(xlabel=r"$\gamma = k/k_x$", ylabel="$P_d$ [%]", title=name)
            events.set(xlabel=r"$\gamma = k/k_x$", ylabel="events a period", yscale="log", title="events")
            power.legend()
            figure.savefig(PICTURES / f"points_{name}.png", dpi=150)
            plt.close(figure)


def table(found: dict[str, dict[str, Any]]) -> str:
    """The table of the page."""
    heads = ["scene", "model", "period 1, aperiodic", "events a period", "loaded case switches", "CPU µs"]
    heads += ["against corner", "error: median, p90"]
    lines = [f"| {' | '.join(heads)} |", "|---" * len(heads) + "|"]
    for name, by_model in found.items():
        base = by_model["corner"]["microseconds"] if "corner" in by_model else np.nan
        for model in filter(by_model.get, MODELS):
            one = by_model[model]
            period, total = np.array(one["period"]), np.sum([*one["events"].values()], axis=0)
            switches = np.median(
                np.sum([own for kind, own in one["events"].items() if kind.startswith("switch")], axis=0)
            )
            error = one["error"]
            cells = [
                f"`{name}`",
                model,
                f"{np.mean(period == 1):.0%}, {np.mean(period == 0):.0%}",
                f"{np.median(total):.1f}",
                f"{switches:.3g}",
                f"{one['microseconds']:.0f}",
                "" if np.isnan(base) else f"{one['microseconds'] / base:.2f}",
                f"{error['median']:.0e}, {error['p90']:.0e}",
            ]
            lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--draw", action="store_true", help="draw the pictures from the stored numbers, and the table")
    parser.add_argument("--scenes", nargs="*", default=[*SCENES])
    parser.add_argument("--models", nargs="*", default=[*MODELS])
    asked = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    found = json.loads(FILE.read_text()) if FILE.exists() else {}
    if asked.draw:
        draw(found)
        print(table(found))
        return
    for name in asked.scenes:
        for model in asked.models:
            found.setdefault(name, {})[model] = figures(name, MODELS[model])
            print(name, model, found[name][model]["microseconds"], found[name][model]["error"], flush=True)
            FILE.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
