"""The pictures of the pages, by the commands that the pages show.

`python docs/pictures.py [NAME ...]` draws them anew. Each command runs in a folder of its own; what the last of them
draws is copied to docs/pictures/NAME.
"""

import shlex
import shutil
import sys
import tempfile
from contextlib import chdir
from pathlib import Path

PICTURES = Path(__file__).parent / "pictures"
SCENE = "fig09_best"
ORDERS = "orders.toml"  # the scene of `engineer_scene`, in every folder
TWO = "table1 --set drive.M_0=0.1 --set drive.omega=545"  # motions coexist there
# Picture -> commands of its page, and what the last of them draws.
COMMANDS = {
    "check.png": (["check fig09_best --engine-orders 1..6 --stop 6000rpm --out sheet"], "sheet/check.png"),
    "orders_check.png": ([f"check {ORDERS} --engine-orders 2,4,6,8 --stop 3000rpm --out sheet"], "sheet/check.png"),
    "orders_power.png": ([f"power {ORDERS} --transient 400 --out power"], "power/power.png"),
    "orders_speed.png": (
        [
            f"sweep {ORDERS} --along drive.speed --start '600 rpm' --stop '1800 rpm' --num 61 --amplitudes --out speed",
            "plot speed --kind amplitude --out speed.png",
        ],
        "speed.png",
    ),
    "orders_level.png": (
        [
            f"sweep {ORDERS} --along drive.level --start 0.2 --stop 2 --num 40 --amplitudes --out level",
            "plot level --kind amplitude --out level.png",
        ],
        "level.png",
    ),
    "orders_effects.png": (
        [
            f"gradient {ORDERS} --wrt 'drive.harmonic[1].F,drive.harmonic[1].phase,drive.F_x_mean[0],shroud.gap_at,"
            "blades.B_x' --relative --out effects.json"
        ],
        "effects.png",
    ),
    "simulate.png": ([f"simulate {SCENE} --periods 20 --out run.nc", "plot run.nc --width 90mm"], "run.png"),
    "row.png": (
        [
            "simulate row_ring12_points --periods 6 --tableau dopri8 --steps-per-period 100 --out ring.nc",
            "plot ring.nc",
        ],
        "ring.png",
    ),
    "row.gif": (
        [
            "simulate row_ring12_points --periods 6 --tableau dopri8 --steps-per-period 100 --out ring.nc",
            "animate ring.nc --periods 1 --out ring.gif",
        ],
        "ring.gif",
    ),
    "sweep.png": (
        [f"sweep {SCENE} --along contact.gamma --start 0.5 --stop 8 --num 500 --out gamma"],
        "gamma/sweep.png",
    ),
    "hysteresis.png": (
        [
            "sweep table1 --set drive.M_0=0.1 --along drive.omega --start 420 --stop 700 --num 200 "
            "--direction both --out both"
        ],
        "both/sweep.png",
    ),
    "diagnose.png": ([f"diagnose {SCENE} --set contact.gamma=2.5 --out diagnosis"], "diagnosis/diagnosis.png"),
    "power.png": ([f"power {SCENE} --set contact.gamma=7 --out power"], "power/power.png"),
    "tune.png": (
        [
            f"tune {SCENE} --over shroud.gap=5um:200um --over contact.gamma=0.1:10 --range drive.F_0=20,40,60 "
            "--steps-per-period 200 --periods 64 --transient 64 --map 12 --out tuned"
        ],
        "tuned/tune.png",
    ),
    "tune_gap.png": (
        ["tune engine_order --over shroud.gap=0um:200um --of x_peak --scan 16 --updates 0 --out tuned"],
        "tuned/tune.png",
    ),
    "robust.png": (
        [
            f"tune {SCENE} --over shroud.gap=5um:100um --over contact.gamma=0.5:6 --range drive.F_0=40,60 "
            "--tolerance shroud.gap=4um --spread friction.mu=20% --spread 'blades.m[1]=5%' --at-least 48 "
            "--most-force 300N --draws 4 --scan 16 --starts 2 --updates 4 --samples 256 --motions 8 --map 8 "
            "--steps-per-period 200 --periods 24 --transient 24 --out robust"
        ],
        "robust/tune.png",
    ),
    "scatter.png": (
        ["scatter fig09_best --tolerance shroud.gap=10um --spread drive.F_0=20% --at-least 35 --out scatter"],
        "scatter/scatter.png",
    ),
    "branch.png": (
        ["branch fig09 --set drive.M_0=0.1 --along contact.gamma --start 0.1 --stop 4 --out branch"],
        "branch/branch.png",
    ),
    "row_branch.png": (
        [
            "branch row_ring12 --set row.blades=4 --set drive.engine_order=2 --set 'parts.motion=[\"x\"]' "
            "--along drive.omega --start 900 --stop 940 --at 915 --most-points 100 --num 80 --tableau dopri8 "
            "--steps-per-period 60 --out branch",
            'plot branch/branch.nc --title "A ring of four in anti-phase"',
        ],
        "branch/branch.png",
    ),
    "row_response.png": (
        [
            "response row_ring12 --set row.blades=4 --set drive.engine_order=2 --set 'parts.motion=[\"x\"]' "
            "--along drive.omega --start 800 --stop 1500 --num 36 --periods 16 --transient 200 --most-points 200 "
            "--tableau dopri8 --steps-per-period 60 --out response",
            'plot response/response.nc --title "A ring of four in anti-phase"',
        ],
        "response/response.png",
    ),
    "response.png": (
        [
            "response engine_order --set 'parts.motion=[\"x\"]' --along drive.speed --start '1200 rpm' "
            "--stop '1700 rpm' --num 100 --out response"
        ],
        "response/response.png",
    ),
    "mistune.png": (
        [
            "mistune row_ring12 --set 'parts.motion=[\"x\"]' --set contact.gamma=0.02 --set friction.k_d=0 "
            "--set drive.engine_order=6 --set blades.c_x=0.36 --along drive.omega --start 1080 --stop 1190 --num 200 "
            "--linear stuck --sigmas 0.005,0.01,0.02 --n-patterns 200 --updates 30 --out mistuned",
            'plot mistuned/mistune.nc --title "A linear ring of twelve, one mode per blade, EO 6"',
        ],
        "mistuned/mistune.png",
    ),
    "mistuned_ring.png": (
        [
            'mistune row_ring12 --set \'parts.motion=["x", "y"]\' --along drive.omega --start 1800 --stop 2700 '
            "--num 19 --accuracy fast --periods 40 --transient 100 --sigmas 0.01,0.03 --n-patterns 20 --seed 1 "
            "--out mistuned",
            'plot mistuned/mistune.nc --title "Twelve blades with gaps and friction, EO 3"',
        ],
        "mistuned/mistune.png",
    ),
    "attractors.png": (
        [f"attractors {TWO} --starts 128 --out attractors"],
        "attractors/attractors.png",
    ),
    "basins.png": (
        [f'basins {TWO} --plane "x[0],v_x[0]" --num 60 --out basins'],
        "basins/basins.png",
    ),
    "lyapunov.png": (
        [
            "sweep table1 --along contact.gamma --start 0.5 --stop 8 --num 100 --lyapunov --out exponents",
            'plot exponents --title "Table 1 with the gap and the force of Fig. 10b"',
        ],
        "exponents/sweep.png",
    ),
    "plot.png": (
        [f"simulate {SCENE} --periods 20 --out run.nc", "plot run.nc --kind forces --width 90mm --out forces.png"],
        "forces.png",
    ),
    "animate.gif": (
        [f"simulate {SCENE} --periods 20 --out run.nc", "animate run.nc --periods 1 --out run.gif"],
        "run.gif",
    ),
}


def gradient(path: Path) -> None:
    """P_d over the gap with slopes at some of its points, as the page of `gradient` says."""
    import jax
    import matplotlib as mpl
    import numpy as np
    from matplotlib.figure import Figure

    from jaxshroud.plotting.style import INK, ORANGE, STYLE

    jax.config.update("jax_enable_x64", True)
    import jaxshroud as js

    scene = js.load("fig09_best", ["contact.gamma=4"]).scene
    gaps, at = np.linspace(1e-5, 2e-4, 96), np.linspace(2e-5, 1.8e-4, 6)
    curve = js.sweep(scene, {"shroud.gap": gaps}, n_periods=64, transient=200)
    slopes = js.gradient(js.scenes_from({"shroud.gap": at}, scene), ["shroud.gap"])
    here, rise = slopes.orbit.P_d, slopes.value["shroud.gap"]
    look = {"color": ORANGE, "lw": 1.6, "marker": "o", "markevery": [1], "ms": 4, "mec": INK, "mew": 0.6}
    with mpl.rc_context(STYLE):
        figure = Figure((90 / 25.4, 65 / 25.4), layout="constrained")
        axes = figure.subplots()
        curve.plot(axes, panel="P_d", unit="um")
        for x, y, m in zip(at, here, rise, strict=True):
            near = x + 1.2e-5 * np.array([-1, 0, 1])
            (slope,) = axes.plot(1e6 * near, y + m * (near - x), **look)
        axes.legend([axes.lines[0], slope], ["sweep", "slope by gradient"], loc="lower left")
        figure.savefig(path, dpi=200)


def orbit(path: Path) -> None:
    """The orbit that is closed in the page of `orbit`."""
    import jax

    jax.config.update("jax_enable_x64", True)
    import jaxshroud as js

    scene = js.load("fig09_best", ["contact.gamma=4"]).scene
    found = js.orbit(scene)
    run = js.simulate(scene, found.start, n_periods=found.q + 1, method=found.method.replace(steps=400))
    run.plot(kind="phase", settled_from=0, width=90).savefig(path, dpi=200)


def fit(path: Path) -> None:
    """Friction, gap and stiffness of contact from noisy displacements of a scene that is known."""
    import jax
    import numpy as np

    jax.config.update("jax_enable_x64", True)
    import jaxshroud as js

    scene, rng = js.load("fig09_best").scene, np.random.default_rng(0)
    run = js.simulate(scene, n_periods=4, every=32, method=js.RungeKutta("dopri8", steps=800))
    x, theta = run.motion.x, run.motion.theta
    signals = {"x_left [m]": x[:, 0], "x_right [m]": x[:, 1], "theta_left [rad]": theta[:, 0]}
    noisy = {name: q + 0.03 * np.std(q) * rng.standard_normal(q.shape) for name, q in signals.items()}
    over = {"friction.mu": (0.1, 1.0), "shroud.gap": (5e-6, 6e-5), "contact.gamma": (0.5, 6.0)}
    found = js.fit(scene, {"t [s]": run.t, **noisy}, over, scan=16, starts=2, method=js.RungeKutta(steps=400))
    found.plot(width=90).savefig(path, dpi=200)


def engineer_scene() -> str:
    """The second scene that a page shows."""
    page = (Path(__file__).parent / "engineer.md").read_text("utf-8")
    return page.split("```toml\n")[2].partition("```")[0]


def drawn(commands: list[str], last: str, to: Path) -> None:
    """Run commands in an empty folder and keep what the last of them draws."""
    from jaxshroud.cli import commands as cli

    with tempfile.TemporaryDirectory() as out, chdir(out):
        Path(ORDERS).write_text(engineer_scene(), "utf-8")
        for command in commands:
            if cli.main(shlex.split(command)):
                raise SystemExit(f"failed: jaxshroud {command}")
        shutil.copy(last, to)


def main() -> None:
    """Draw the pictures named, by default all."""
    drawers = {"gradient.png": gradient, "fit.png": fit, "orbit.png": orbit}
    for name in sys.argv[1:] or [*COMMANDS, *drawers]:
        if name in drawers:
            drawers[name](PICTURES / name)
        else:
            drawn(*COMMANDS[name], PICTURES / name)


if __name__ == "__main__":
    main()
