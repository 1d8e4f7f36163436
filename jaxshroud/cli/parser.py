"""All verbs with their options. Nothing here is slow to import: a verb's module is imported when it runs."""

import argparse
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple, get_args

from jaxshroud.cli.words import OneLineParser, accuracy, count, number, path, positive, steps, width
from jaxshroud.march.words import METHODS, Locate
from jaxshroud.scene.checks import Precision
from jaxshroud.version import __version__

SEEDS = 10**18
# Pictures of a run: pages of panels and single panels.
RUN_KINDS = ("motion", "forces", "all", "history", "phase", "poincare", "spectrum", "ribbon", "loop", "path")
SPREAD = 2.0  # of random starts
UNITS = ("mm", "um", "m", "gap")
MAP, MOST_MAP = 24, 1000  # values of each of two keys in the map behind the paths of a tuning


@dataclass
class Along:
    """One axis asked for on the command line."""

    key: str | None = None  # None: that of the scene
    values: str | None = None
    start: str | None = None
    stop: str | None = None
    num: str | None = None


class _NewAxis(argparse.Action):
    def __call__(self, parser, namespace, values, option_string=None):
        """Begin a new axis."""
        if namespace.along and namespace.along[0].key is None:
            parser.error(f"{option_string} {values} comes after what describes it; give it first")
        namespace.along = [*(namespace.along or []), Along(str(values))]


class _OfAxis(argparse.Action):
    def __call__(self, parser, namespace, values, option_string=None):
        """Describe the latest axis, or the scene's own."""
        if namespace.along is None:
            namespace.along = [Along()]
        setattr(namespace.along[-1], self.dest.removeprefix("axis_"), str(values))


def scene_options(made: OneLineParser, method: bool = True) -> None:
    """Options of every command that simulates a scene; those of the march only if it has a `method` to choose."""
    made.add_argument("scene", metavar="SCENE", help="a TOML file or the name of a shipped scene")
    made.add_argument("--set", action="append", default=[], metavar="K=V", help="override table.key=value")
    made.add_argument("--periods", type=count(1), metavar="N", help="periods kept")
    made.set_defaults(steps_per_period=None)
    if method:
        made.add_argument(
            "--accuracy", type=accuracy, metavar="A", help="fast, balanced, reference or a number: chooses all below"
        )
        made.add_argument("--steps-per-period", type=steps, metavar="N", help='or "auto"')
        made.add_argument("--tableau", choices=METHODS, help="Runge-Kutta method, rk4 by default; or power series")
        made.add_argument("--order", type=count(1), metavar="N", help="of --tableau taylor")
        made.add_argument("--step-tolerance", type=number, metavar="R", help="of --tableau taylor")
        made.add_argument("--locate", choices=get_args(Locate), help="how events are located")
        made.add_argument("--precision", choices=get_args(Precision), help="float64 by default")
    made.add_argument("--force", action="store_true", help="replace existing results")


def check_options(made: OneLineParser) -> None:
    """Options of `jaxshroud check`."""
    scene_options(made, method=False)


def simulate_options(made: OneLineParser) -> None:
    """Options of `jaxshroud simulate`."""
    scene_options(made)
    made.add_argument("--every", type=count(1), default=1, metavar="M", help="store every M-th step")
    made.add_argument("--events", action="store_true", help="store the states on both sides of every event too")
    made.add_argument("--from", dest="earlier", type=path, metavar="FILE.nc", help="start from its last state")
    made.add_argument("--out", type=path, required=True, metavar="FILE.nc")


def sweep_options(made: OneLineParser) -> None:
    """Options of `jaxshroud sweep`."""
    scene_options(made)
    made.add_argument("--along", action=_NewAxis, metavar="KEY", help="key to vary; twice makes a grid")
    for name, text in dict(values="a,b,c", start="A", stop="B", num="N").items():
        made.add_argument(f"--{name}", dest=f"axis_{name}", action=_OfAxis, metavar=text, help="of the last --along")
    made.add_argument("--direction", choices=("independent", "forward", "backward", "both"))
    made.add_argument("--transient", type=count(0), metavar="N", help="periods discarded first")
    made.add_argument("--phase", type=number, default=0.0, metavar="RAD", help="drive phase of the samples")
    made.add_argument("--period-tol", type=number, default=1e-3, help="relative tolerance of the period number")
    made.add_argument("--lyapunov", action="store_true", help="compute the largest Lyapunov exponent of every lane too")
    made.add_argument("--no-samples", action="store_true", help="numbers of each lane only: for maps of many lanes")
    made.add_argument("--store", choices=("nc", "zarr"), help="zarr: block by block; by default above 1 GiB of results")
    made.add_argument("--resume", action="store_true", help="go on with DIR/sweep.zarr of a run that was ended")
    made.add_argument(
        "--scheduler", metavar="WHERE", help="Dask's: compute on its workers; an address, its file, or local:N"
    )
    made.add_argument("--ledger", action="store_true", help="keep every lane's energy balance (10 to 20 %% slower)")
    made.add_argument("--forces", action="store_true", help="and its largest contact forces and the work of friction")
    made.add_argument("--out", type=path, required=True, metavar="DIR")


def diagnose_options(made: OneLineParser) -> None:
    """Options of `jaxshroud diagnose`."""
    scene_options(made)
    made.add_argument("--transient", type=count(0), metavar="N", help="periods run first")
    made.add_argument("--out", type=path, required=True, metavar="DIR")


def power_options(made: OneLineParser) -> None:
    """Options of `jaxshroud power`."""
    scene_options(made)
    made.add_argument("--transient", type=count(0), metavar="N", help="periods discarded first")
    made.add_argument("--tolerance", type=number, default=0.1, help="percentage points at which P_d counts as stable")
    made.add_argument("--out", type=path, required=True, metavar="DIR")


def gradient_options(made: OneLineParser) -> None:
    """Options of `jaxshroud gradient`."""
    scene_options(made)
    made.add_argument("--transient", type=count(0), metavar="N", help="periods discarded first, where smoothed")
    made.add_argument(
        "--wrt", required=True, metavar="K1,K2", help="numbers of the scene, e.g. shroud.gap; all: every one"
    )
    made.add_argument("--relative", action="store_true", help="tell and draw what 1 percent of each number changes")
    made.add_argument("--of", choices=("P_d", "P"), default="P_d")
    made.add_argument("--sigma", type=number, default=0.01, help="relative width of the smoothing, in chaos")
    made.add_argument("--pairs", type=count(2), default=128, metavar="N", help="pairs of samples, in chaos")
    made.add_argument("--seed", type=count(0, SEEDS), default=0, metavar="N", help="of the samples")
    made.add_argument("--check", action="store_true", help="compare with differences at three step sizes")
    made.add_argument("--out", type=path, required=True, metavar="FILE.json")


def tune_options(made: OneLineParser) -> None:
    """Options of `jaxshroud tune`."""
    scene_options(made)
    made.add_argument("--transient", type=count(0), metavar="N", help="periods discarded first")
    made.add_argument("--over", action="append", required=True, metavar="K=LO:HI", help="number to tune, its bounds")
    made.add_argument("--range", action="append", default=[], metavar="K=A,B,C", help="operating condition, its values")
    made.add_argument("--goal", choices=("mean", "worst"), default="mean", help="of P_d over the conditions")
    made.add_argument("--most-penetration", metavar="LENGTH", help="limit, e.g. 0.2mm")
    made.add_argument("--most-force", metavar="FORCE", help="limit of the normal force, e.g. 500N")
    made.add_argument("--scan", type=count(1), metavar="N", help="designs looked at first")
    made.add_argument("--starts", type=count(1), metavar="N", help="the best of them, to climb from")
    made.add_argument("--updates", type=count(1), metavar="N", help="steps of each path")
    _tolerances(made)
    made.add_argument("--draws", type=count(1), default=16, metavar="N", help="of the scatter, in the search")
    made.add_argument(
        "--loss", type=positive, metavar="D", help="points of P_d that a tolerance may cost; 1 by default"
    )
    made.add_argument("--at-least", type=number, metavar="P_d", help="P_d [%%] whose probability is asked for")
    made.add_argument("--samples", type=count(2), default=1024, metavar="N", help="independent draws behind it")
    made.add_argument("--motions", type=count(0), default=32, metavar="N", help="random starts, for coexisting motions")
    made.add_argument("--map", type=count(0, MOST_MAP), metavar="N", help="values a side of the map, or 0")
    made.add_argument("--seed", type=count(0, SEEDS), default=0, metavar="N")
    made.add_argument("--out", type=path, required=True, metavar="DIR")


def branch_options(made: OneLineParser) -> None:
    """Options of `jaxshroud branch`."""
    scene_options(made)
    made.add_argument("--transient", type=count(0), metavar="N", help="periods discarded first, of the sweep behind")
    made.add_argument("--along", required=True, metavar="KEY", help="number of the scene to follow along")
    made.add_argument("--start", metavar="A", help="where its range begins; by default as the scene sweeps it")
    made.add_argument("--stop", metavar="B", help="where its range ends")
    made.add_argument("--at", metavar="VALUE", help="where to begin; by default the scene's own value")
    made.add_argument("--num", type=count(0), default=200, metavar="N", help="values of the sweep behind, or 0")
    made.add_argument("--most-points", type=count(2), default=400, metavar="N", help="of a branch in one direction")
    made.add_argument(
        "--doublings", type=count(0), default=1, metavar="N", help="orbits of twice the period from flips"
    )
    made.add_argument("--out", type=path, required=True, metavar="DIR")


def attractors_options(made: OneLineParser) -> None:
    """Options of `jaxshroud attractors`."""
    scene_options(made)
    made.add_argument("--starts", type=count(1), default=256, metavar="N", help="random starts")
    made.add_argument("--spread", type=number, default=SPREAD, help="of the starts, in what they reach without contact")
    made.add_argument("--seed", type=count(0, SEEDS), default=0, metavar="N", help="of the starts")
    made.add_argument("--most-periods", type=count(64), default=1024, metavar="N", help="until a motion is aperiodic")
    made.add_argument("--out", type=path, required=True, metavar="DIR")


def basins_options(made: OneLineParser) -> None:
    """Options of `jaxshroud basins`."""
    scene_options(made)
    made.add_argument("--plane", default="x[0],v_x[0]", metavar="A,B", help="two numbers of the initial motion")
    made.add_argument("--start", metavar="A,B", help="where their ranges begin, e.g. --start=-1mm,-0.5")
    made.add_argument("--stop", metavar="A,B", help="where their ranges end")
    made.add_argument("--num", type=count(2), default=100, metavar="N", help="values of each")
    made.add_argument("--most-periods", type=count(64), default=512, metavar="N", help="until a motion is aperiodic")
    made.add_argument("--out", type=path, required=True, metavar="DIR")


def trade_options(made: OneLineParser) -> None:
    """Options of `jaxshroud trade`."""
    scene_options(made, method=False)
    made.add_argument("--transient", type=count(0), metavar="N", help="periods discarded before P_d is averaged")
    made.add_argument("--lanes", type=count(8), default=64, metavar="N", help="scenes scattered around the scene")
    made.add_argument("--seed", type=count(0, SEEDS), default=0, metavar="N", help="of the scattering")
    made.add_argument("--out", type=path, required=True, metavar="DIR")


def plot_options(made: OneLineParser) -> None:
    """Options of `jaxshroud plot`."""
    made.add_argument("source", type=path, metavar="DIR|FILE")
    made.add_argument("--kind", choices=RUN_KINDS, help="of a run; by default its motion")
    made.add_argument("--title", metavar="TEXT", help='in place of the result\'s own; "" for none')
    made.add_argument("--xlabel", metavar="TEXT")
    made.add_argument("--unit", choices=UNITS, help="of displacements and swept lengths; gap: x over the gap")
    made.add_argument("--width", type=width, metavar="LENGTH", help="of the picture, e.g. 90mm")
    made.add_argument("--format", choices=("png", "pdf", "svg"), help="by default that of --out, or png")
    made.add_argument("--style", metavar="FILE.mplstyle", help="of matplotlib, over the package's own")
    made.add_argument("--out", type=path, metavar="PICTURE", help="by default beside the result")
    made.add_argument("--force", action="store_true", help="replace a picture named by --out")


def convert_options(made: OneLineParser) -> None:
    """Options of `jaxshroud convert`."""
    made.add_argument("source", type=path, metavar="FILE.nc")
    made.add_argument("--rows", choices=("lane", "sample"), help="of a table; lanes where there are many, else samples")
    made.add_argument("--out", type=path, required=True, metavar="FILE", help="ends in .csv, .mat or .nc")
    made.add_argument("--force", action="store_true", help="replace an existing file")


def animate_options(made: OneLineParser) -> None:
    """Options of `jaxshroud animate`."""
    made.add_argument("source", type=path, metavar="FILE.nc", help="a run that `simulate` has stored")
    made.add_argument("--periods", type=count(1), metavar="N", help="periods shown; by default those of the motion")
    made.add_argument("--factor", type=positive, metavar="X", help="by which motion and gap are exaggerated")
    made.add_argument("--title", metavar="TEXT", help='in place of the run\'s own; "" for none')
    made.add_argument("--out", type=path, required=True, metavar="FILE.gif|FILE.mp4", help="mp4 needs ffmpeg")
    made.add_argument("--force", action="store_true", help="replace an existing file")


def _nothing(_: OneLineParser) -> None: ...


def _scattering(made: OneLineParser) -> None:
    """Numbers that scatter."""
    made.add_argument("--over", action="append", default=[], metavar="K=LO:HI", help="number and its bounds")
    _tolerances(made)


def _tolerances(made: OneLineParser) -> None:
    made.add_argument("--tolerance", action="append", default=[], metavar="K=D", help="number, to D on either side")
    made.add_argument("--spread", action="append", default=[], metavar="K=P%", help="number, to P percent either side")


def report_options(made: OneLineParser) -> None:
    """Options of `jaxshroud report`."""
    scene_options(made)
    made.add_argument("--transient", type=count(0), metavar="N", help="periods discarded first")
    made.add_argument("--tune", type=path, metavar="DIR", help="a tuning whose design, conditions and limits count")
    _scattering(made)
    made.add_argument("--range", action="append", default=[], metavar="K=A,B,C", help="operating condition, its values")
    made.add_argument("--at-least", type=number, metavar="P_d", help="P_d [%%] that is to be met")
    made.add_argument("--most-penetration", metavar="LENGTH", help="limit, e.g. 0.2mm")
    made.add_argument("--most-force", metavar="FORCE", help="limit of the normal force, e.g. 500N")
    made.add_argument("--samples", type=count(2), default=128, metavar="N", help="rows of draws of the scatter")
    made.add_argument("--starts", type=count(1), default=64, metavar="N", help="random starts")
    made.add_argument("--seed", type=count(0, SEEDS), default=0, metavar="N")
    made.add_argument("--out", type=path, required=True, metavar="FILE", help="report.html or report.pdf")


def scatter_options(made: OneLineParser) -> None:
    """Options of `jaxshroud scatter`."""
    scene_options(made)
    made.add_argument("--transient", type=count(0), metavar="N", help="periods discarded first")
    _scattering(made)
    made.add_argument("--at-least", type=number, metavar="P_d", help="P_d [%%] whose probability is asked for")
    made.add_argument("--samples", type=count(2), default=256, metavar="N", help="rows of draws, a power of 2")
    made.add_argument("--seed", type=count(0, SEEDS), default=0, metavar="N")
    made.add_argument("--out", type=path, required=True, metavar="DIR")


class Verb(NamedTuple):
    """A question that can be asked; the module of its name answers it."""

    text: str
    example: str
    options: Callable[[OneLineParser], None]


VERBS = {
    "simulate": Verb(
        "Integrate one scene and store its motion at every step.",
        "jaxshroud simulate fig10b --periods 20 --out fig10b.nc",
        simulate_options,
    ),
    "sweep": Verb(
        "Simulate a scene for many values of one or two of its numbers.",
        "jaxshroud sweep fig09 --out fig09\n"
        "  jaxshroud sweep table1 --along contact.gamma --start 0 --stop 8 --num 200 --transient 100 --out gamma",
        sweep_options,
    ),
    "diagnose": Verb(
        "Say what kind of motion a scene settles on, and why, on one page.",
        "jaxshroud diagnose fig10b --out fig10b",
        diagnose_options,
    ),
    "power": Verb(
        "Vibration-power reduction P_d of one scene and its convergence.",
        "jaxshroud power fig15a --out fig15a",
        power_options,
    ),
    "gradient": Verb(
        "Derivatives of P_d with respect to numbers of a scene.",
        "jaxshroud gradient fig10b --wrt shroud.gap,contact.gamma --check --out gradient.json",
        gradient_options,
    ),
    "tune": Verb(
        "Find the numbers of a scene that reduce the vibration most.",
        "jaxshroud tune table1 --set drive.M_0=10 --over shroud.gap=5um:200um --over contact.gamma=0.1:10 "
        "--range drive.F_0=20,40,60,80 --out tuned",
        tune_options,
    ),
    "scatter": Verb(
        "How P_d scatters where numbers of a scene do, with the probability of a wanted P_d and Sobol indices.",
        "jaxshroud scatter fig09_best --tolerance shroud.gap=10um --spread drive.F_0=20% --at-least 35 --out scatter",
        scatter_options,
    ),
    "report": Verb(
        "All that is known of a design, with a verdict, as one HTML or PDF document.",
        "jaxshroud report fig09_best --tolerance shroud.gap=10um --at-least 35 --out report.html",
        report_options,
    ),
    "branch": Verb(
        "Follow a periodic orbit along a number of a scene, past folds and flips, stable or not.",
        "jaxshroud branch fig09 --set drive.M_0=0.1 --along contact.gamma --start 0.1 --stop 4 --out branch",
        branch_options,
    ),
    "attractors": Verb(
        "Find the motions that coexist in a scene, from random starts, with their shares and P_d.",
        "jaxshroud attractors fig10b --starts 256 --out attractors",
        attractors_options,
    ),
    "basins": Verb(
        "Draw which motion each start of a plane ends on.",
        'jaxshroud basins fig10b --plane "x[0],v_x[0]" --num 100 --out basins',
        basins_options,
    ),
    "trade": Verb(
        "Measure accuracy against cost on a scene of your own.", "jaxshroud trade table1 --out trade", trade_options
    ),
    "explain": Verb(
        "Say what the model of a scene consists of, what it lacks and what it costs.",
        'jaxshroud explain table1 --set \'parts.motion=["x", "y"]\'',
        scene_options,
    ),
    "check": Verb(
        "Print a scene's data sheet: frequencies, damping ratios, amplitudes against the gap, and what is doubtful.",
        "jaxshroud check table1",
        check_options,
    ),
    "plot": Verb("Draw stored results again, without simulating.", "jaxshroud plot fig09", plot_options),
    "convert": Verb(
        "Write a stored result as CSV, MATLAB or NetCDF file.",
        "jaxshroud convert gap/sweep.nc --out gap.csv",
        convert_options,
    ),
    "animate": Verb(
        "Show a stored run as a moving picture.", "jaxshroud animate run.nc --out run.gif", animate_options
    ),
    "scenes": Verb("List the shipped scenes.", "jaxshroud scenes", _nothing),
}


def parser() -> OneLineParser:
    """The parser of all verbs."""
    top = OneLineParser(
        prog="jaxshroud",
        description="Rub-impact dynamics of two shrouded blades under bending-torsion coupling.",
    )
    top.add_argument("--version", action="version", version=__version__)
    verbs = top.add_subparsers(dest="verb", required=True, metavar="VERB", parser_class=OneLineParser)
    for name, (text, example, options) in VERBS.items():
        made = verbs.add_parser(
            name,
            help=text,
            description=text,
            epilog=f"example:\n  {example}",
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        options(made)
    return top
