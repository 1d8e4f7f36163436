"""All commands: what each says of itself, its options, and how its verb is called. Nothing here is slow to import."""

from typing import NamedTuple

from jaxshroud.cli.option_table import (
    METHOD_FLAGS,
    SCATTER_FLAGS,
    SCENE_FLAGS,
    AxisPart,
    NewAxis,
    Option,
    count,
    engine_orders,
    number,
    path,
    positive,
    shared_option,
    shares,
    speed,
    width,
)
from jaxshroud.march.method_names import LINEAR_STATES, RANKED_BY, RESPONSES
from jaxshroud.scene.quantities import REQUIRED_REDUCTIONS

# Pictures of a run: pages of panels and single panels.
RUN_KINDS = ("motion", "forces", "all", "history", "phase", "poincare", "spectrum", "ribbon", "loop", "path")
SWEEP_KINDS = ("amplitude",)  # of a sweep, beside its own picture
PICTURE_KINDS = (*RUN_KINDS, *SWEEP_KINDS)
UNITS = ("mm", "um", "m", "gap")
DEFAULT_SPREAD = 2.0  # of random starts
MAX_PORT = 65535
MAX_MAP_SIDE = 1000  # values of each of two keys in the map behind the paths of a tuning
SIMULATION = (*SCENE_FLAGS, *METHOD_FLAGS, "--force")


class Command(NamedTuple):
    """A command of the name of a verb, or one of the command line alone."""

    text: str
    example: str
    options: tuple[str | Option, ...] = ()  # those of `option_table` by their names
    arguments: tuple[str, ...] = ()  # of the verb: options of the same name, or n_periods and transient of [run]
    files: tuple[str, ...] = ()  # written into the folder --out; none: --out is the file
    unit: str = "lane-periods"  # of progress
    module: str = ""  # of `cli` with NAME_command, for a command that has something special


COMMANDS = {
    "simulate": Command(
        "Integrate one scene and store its motion at every step.",
        "jaxshroud simulate fig10b --periods 20 --out fig10b.nc",
        (
            *SIMULATION,
            Option("--every", "store every M-th step", count(1), 1, metavar="M"),
            Option("--events", "store the states on both sides of every event too", action="store_true"),
            Option("--from", "start from its last state", path, metavar="FILE.nc", dest="earlier"),
            shared_option("--out", metavar="FILE.nc"),
        ),
        arguments=("n_periods", "every", "events"),
        unit="steps",
        module="runs",
    ),
    "sweep": Command(
        "Simulate a scene for many values of one or two of its numbers.",
        "jaxshroud sweep fig09 --out fig09\n"
        "  jaxshroud sweep table1 --along contact.gamma --start 0 --stop 8 --num 200 --transient 100 --out gamma",
        (
            *SIMULATION,
            Option("--along", "key to vary; twice makes a grid", metavar="KEY", action=NewAxis),
            *(
                Option(f"--{name}", "of the last --along", metavar=metavar, action=AxisPart, dest=f"axis_{name}")
                for name, metavar in dict(values="a,b,c", start="A", stop="B", num="N").items()
            ),
            Option(
                "--direction",
                "lanes are independent, or each starts where its neighbour ended",
                choices=("independent", "forward", "backward", "both"),
            ),
            "--transient",
            "--linear",
            Option("--phase", "drive phase of the samples", number, 0.0, metavar="RAD"),
            Option("--period-tol", "relative tolerance of the period number", number, 1e-3),
            Option("--lyapunov", "compute the largest Lyapunov exponent of every lane too", action="store_true"),
            Option("--no-samples", "store only the numbers of each lane: for maps of many lanes", action="store_true"),
            Option(
                "--store", "zarr: written block by block, the default above 1 GiB of results", choices=("nc", "zarr")
            ),
            Option("--resume", "continue an interrupted run in DIR/sweep.zarr", action="store_true"),
            Option("--scheduler", "Dask scheduler to compute on: an address, its file, or local:N", metavar="WHERE"),
            Option("--ledger", "keep every lane's energy balance (10 to 20 %% slower)", action="store_true"),
            Option(
                "--confirm", "mark lanes that a finer march settles elsewhere (twice the time)", action="store_true"
            ),
            "--forces",
            "--amplitudes",
            "--out",
        ),
        module="sweep",
    ),
    "explore": Command(
        "Look at a scene on a page of this machine: a click on its diagram shows the motion.",
        "jaxshroud explore fig09_best",
        (
            *SCENE_FLAGS[:2],
            shared_option("--accuracy", help="fast, by default, balanced, reference or a number", default="fast"),
            Option("--port", "of this machine; by default any that is free", count(0, MAX_PORT), 0, metavar="N"),
            Option("--no-browser", "only print the address", action="store_true"),
            shared_option(
                "--out", help="write the page, without a server, and end", metavar="FILE.html", required=None
            ),
            shared_option("--force", help="replace an existing file"),
        ),
        module="explore",
    ),
    "table": Command(
        "Compute the designs of a CSV table, a row for each, and rank them.",
        "jaxshroud table designs.csv --scene fig09_best --out ranked.csv",
        (
            Option("designs", "CSV: a key and unit heads each column, e.g. shroud.gap [mm]", path, metavar="FILE.csv"),
            Option("--scene", "what no column gives; by default table1", default="table1", metavar="SCENE"),
            *SCENE_FLAGS[1:],
            *METHOD_FLAGS,
            "--force",
            "--transient",
            "--linear",
            Option("--by", "number to rank by; by default the largest P_d", choices=RANKED_BY),
            shared_option("--out", help="ranked table; or .nc", metavar="FILE.csv"),
        ),
        arguments=("n_periods", "transient", "by"),
        module="design",
    ),
    "diagnose": Command(
        "Say what kind of motion a scene settles on, and why, on one page.",
        "jaxshroud diagnose fig10b --out fig10b",
        (*SIMULATION, shared_option("--transient", help="periods run first"), "--out"),
        arguments=("transient",),
        files=("diagnosis.nc", "diagnosis.json", "diagnosis.png", "diagnosis.pdf"),
        unit="periods",
        module="runs",
    ),
    "power": Command(
        "Vibration-power reduction P_d of one scene and its convergence.",
        "jaxshroud power fig15a --out fig15a",
        (
            *SIMULATION,
            "--linear",
            "--transient",
            "--forces",
            "--amplitudes",
            Option("--tolerance", "percentage points at which P_d counts as stable", number, 0.1, dest="stable_within"),
            "--out",
        ),
        arguments=("n_periods", "transient", "stable_within", "forces", "amplitudes"),
        files=("power.nc", "power.json", "power.png"),
        unit="periods",
        module="runs",
    ),
    "orbit": Command(
        "Close the periodic orbit that a scene settles on, with its Floquet multipliers.",
        "jaxshroud orbit fig09_best --set contact.gamma=4 --out orbit",
        (
            *SIMULATION,
            shared_option("--most-periods", default=1024),
            "--amplitudes",
            Option("--tolerance", "relative closing error; 1e-11 by default, 1e-7 in float32", positive, metavar="R"),
            "--out",
        ),
        arguments=("most_periods", "tolerance", "amplitudes"),
        files=("orbit.nc", "summary.json"),
        module="orbits",
    ),
    "lyapunov": Command(
        "Lyapunov exponents of the motion that a scene settles on, with intervals.",
        "jaxshroud lyapunov table1 --set contact.gamma=5.5 --out lyapunov",
        (*SIMULATION, "--transient", "--out"),
        arguments=("n_periods", "transient"),
        files=("lyapunov.nc", "summary.json"),
    ),
    "gradient": Command(
        "Derivatives of P_d, or of an amplitude, with respect to numbers of a scene.",
        "jaxshroud gradient fig10b --wrt shroud.gap,contact.gamma --check --out gradient.json",
        (
            *SIMULATION,
            "--linear",
            shared_option("--transient", help="periods discarded first, where smoothed"),
            Option("--wrt", "numbers of the scene, e.g. shroud.gap; all: every one", metavar="K1,K2", required=True),
            Option("--relative", "print and draw the effect of 1 percent more of each number", action="store_true"),
            "--of",
            Option("--sigma", "relative width of the smoothing, in chaos", number, 0.01),
            Option("--pairs", "pairs of samples, in chaos", count(2), 128, metavar="N"),
            shared_option("--seed", help="seed of the samples"),
            Option("--check", "compare with differences at three step sizes", action="store_true"),
            shared_option("--out", metavar="FILE.json"),
        ),
        arguments=("n_periods", "transient", "of", "sigma", "pairs", "seed"),
        unit="periods",
        module="numbers",
    ),
    "tune": Command(
        "Find the numbers of a scene that reduce the vibration most.",
        "jaxshroud tune table1 --set drive.M_0=10 --over shroud.gap=5um:200um --over contact.gamma=0.1:10 "
        "--range drive.F_0=20,40,60,80 --out tuned",
        (
            *SIMULATION,
            "--linear",
            "--transient",
            shared_option("--over", help="number to tune and its bounds", default=None, required=True),
            "--range",
            Option("--goal", "mean or worst P_d over the conditions", choices=("mean", "worst"), default="mean"),
            shared_option("--of", help="what is tuned: P_d, or what is to be small"),
            "--most-penetration",
            "--most-force",
            Option("--scan", "designs that are evaluated first", count(1), metavar="N"),
            shared_option("--starts", help="best of these designs, from which paths begin", dest="n_starts"),
            Option("--updates", "steps of each path; 0: no paths", count(0), metavar="N"),
            "--tolerance",
            "--spread",
            Option("--draws", "draws of the scatter in the search", count(1), 16, metavar="N"),
            Option("--loss", "percentage points of P_d that a tolerance may cost; 1 by default", positive, metavar="D"),
            "--at-least",
            shared_option("--samples", help="independent draws for --at-least", default=1024, dest="check_draws"),
            Option("--motions", "random starts in the search for coexisting motions", count(0), 32, metavar="N"),
            Option("--map", "values of each key in the map; 0: no map", count(0, MAX_MAP_SIDE), metavar="N"),
            "--seed",
            "--out",
        ),
        arguments=(
            *("n_periods", "transient", "goal", "of", "draws", "loss", "at_least", "check_draws", "motions", "seed"),
        ),
        files=("tune.nc", "tune.json", "tune.png", "best.toml"),
        module="design",
    ),
    "fit": Command(
        "Find numbers of a scene from measurements, with intervals and what the data do not determine.",
        "jaxshroud fit fig09_best measured.csv --over friction.mu=0.1:1 --over shroud.gap=5um:60um --out fit",
        (
            "scene",
            Option("measurements", "columns `name [unit]`: t or omega, and channels", path, metavar="DATA.csv"),
            "--set",
            *METHOD_FLAGS,
            "--force",
            shared_option("--over", help="number to fit and its bounds", default=None, required=True),
            Option("--scan", "points that are tried first", count(1), 64, metavar="N"),
            shared_option("--starts", help="best of them, from which least squares begin", default=4),
            shared_option("--most-periods", default=512),
            "--seed",
            "--out",
        ),
        arguments=("scan", "starts", "most_periods", "seed"),
        files=("fit.nc", "fit.png", "summary.json", "best.toml"),
        unit="evaluations",
        module="numbers",
    ),
    "scatter": Command(
        "How P_d scatters where numbers of a scene do, with the probability of a wanted P_d and Sobol indices.",
        "jaxshroud scatter fig09_best --tolerance shroud.gap=10um --spread drive.F_0=20% --at-least 35 --out scatter",
        (
            *SIMULATION,
            "--linear",
            "--transient",
            *SCATTER_FLAGS,
            "--of",
            "--at-least",
            shared_option("--samples", help="rows of draws, a power of 2", default=256, dest="draws"),
            "--seed",
            "--out",
        ),
        arguments=("n_periods", "transient", "of", "at_least", "draws", "seed"),
        files=("scatter.nc", "scatter.png", "summary.json"),
        module="numbers",
    ),
    "report": Command(
        "All that is known of a design, with a verdict, as one HTML or PDF document.",
        "jaxshroud report fig09_best --tolerance shroud.gap=10um --at-least 35 --out report.html",
        (
            *SIMULATION,
            "--transient",
            Option("--tune", "a tuning whose design, conditions and limits count", path, metavar="DIR"),
            *SCATTER_FLAGS,
            "--range",
            shared_option("--at-least", help="P_d [%%] that the design must reach"),
            shared_option(
                "--of", help="P_d, or that of the worst blade of a row", choices=REQUIRED_REDUCTIONS, default=None
            ),
            "--most-penetration",
            "--most-force",
            shared_option("--samples", default=128, dest="draws"),
            shared_option("--starts", default=64),
            "--seed",
            shared_option("--out", help="report.html or report.pdf", metavar="FILE"),
        ),
        arguments=("of", "draws", "starts", "seed"),
        unit="parts",
        module="design",
    ),
    "branch": Command(
        "Follow a periodic orbit along a number of a scene, past folds and flips, stable or not.",
        "jaxshroud branch fig09 --set drive.M_0=0.1 --along contact.gamma --start 0.1 --stop 4 --out branch",
        (
            *SIMULATION,
            shared_option("--transient", help="periods discarded first in the background sweep"),
            Option("--along", "number of the scene to follow along", metavar="KEY", required=True),
            Option("--start", "where its range begins; by default as the scene sweeps it", metavar="A"),
            Option("--stop", "where its range ends", metavar="B"),
            Option("--at", "where to begin; by default the scene's own value", metavar="VALUE"),
            Option("--num", "values of the background sweep; 0: no sweep", count(0), 200, metavar="N"),
            Option("--most-points", "points of a branch in one direction, at most", count(2), 400, metavar="N"),
            Option(
                "--doublings", "how often orbits of twice the period are followed from flips", count(0), 1, metavar="N"
            ),
            "--out",
        ),
        arguments=("along", "most_points", "doublings"),
        files=("branch.nc", "branch.png", "summary.json"),
        unit="drive periods",
        module="orbits",
    ),
    "response": Command(
        "Frequency response: an amplitude over a number, swept both ways and followed as a branch, with its peaks.",
        'jaxshroud response engine_order --along drive.speed --start "1200 rpm" --stop "1700 rpm" --out response',
        (
            *SIMULATION,
            "--linear",
            shared_option("--transient", help="periods discarded first in the sweeps"),
            Option("--along", "number of the scene; by default the drive frequency", metavar="KEY"),
            Option("--start", "where its range begins; by default as the scene sweeps it", metavar="A"),
            Option("--stop", "where its range ends", metavar="B"),
            Option("--num", "values of the sweeps", count(2), 200, metavar="N"),
            Option("--of", "amplitude whose peaks are sought; by default x_peak", choices=RESPONSES, metavar="Q"),
            Option("--over", "second number and its values: a family", metavar="K=A,B,C"),
            Option("--at", "where the branch begins; by default the scene's own value", metavar="VALUE"),
            Option(
                "--most-points",
                "points of a branch in one direction, at most; by default it goes on until its range ends",
                count(2),
                metavar="N",
            ),
            Option(
                "--doublings",
                "how often orbits from flips and broken waves of rings are followed; by default 0, of rows 1",
                count(0),
                metavar="N",
            ),
            "--out",
        ),
        arguments=("n_periods", "transient", "num", "most_points", "doublings"),
        files=("response.nc", "response.png", "summary.json"),
        module="orbits",
    ),
    "mistune": Command(
        "How far mistuning amplifies the largest amplitude of a row of blades, over random patterns.",
        "jaxshroud mistune row_ring12 --along drive.omega --start 900 --stop 1500 --num 40 --sigmas 0.01,0.03 "
        "--n-patterns 200 --out mistuned",
        (
            *SIMULATION,
            shared_option("--transient", help="periods discarded first"),
            Option(
                "--along", "number whose range holds the resonances; by default as the scene sweeps it", metavar="KEY"
            ),
            Option("--start", "where its range begins", metavar="A"),
            Option("--stop", "where its range ends", metavar="B"),
            Option("--num", "its values", count(2), 40, metavar="N"),
            Option("--sigmas", "standard deviations of the mistuning", shares, [0.03], metavar="A,B"),
            Option("--n-patterns", "random patterns of each", count(1), 100, metavar="N"),
            Option(
                "--pattern",
                "intentional pattern about which they are drawn: none, alternate:0.02, harmonic:3:0.02; repeatable",
                metavar="PATTERN",
                action="append",
                dest="designs",
            ),
            Option("--of", "amplitude that counts", choices=RESPONSES, default="x_peak", metavar="Q"),
            Option(
                "--direction",
                "values start from rest, or each where its neighbour ended",
                choices=("independent", "forward", "backward", "both"),
                default="independent",
            ),
            Option("--linear", "state of contact in which all interfaces stay: in closed form", choices=LINEAR_STATES),
            Option("--scan", "patterns that a search for the worst one tries first", count(1), 32, metavar="N"),
            shared_option("--starts", help="best of them, from which its paths begin", default=4),
            Option("--updates", "steps of each path; 0: no search", count(0), 0, metavar="N"),
            shared_option("--seed", help="seed of the patterns"),
            Option("--resume", "continue an interrupted run in DIR/mistune.zarr", action="store_true"),
            "--out",
        ),
        arguments=(
            *("n_periods", "transient", "sigmas", "n_patterns", "of", "direction", "linear"),
            *("scan", "starts", "updates", "seed", "resume"),
        ),
        files=("mistune.nc", "mistune.png", "summary.json"),
        module="mistune",
    ),
    "attractors": Command(
        "Find the motions that coexist in a scene, from random starts, with their shares and P_d.",
        "jaxshroud attractors fig10b --starts 256 --out attractors",
        (
            *SIMULATION,
            shared_option("--starts", default=256),
            Option(
                "--spread",
                "range of the starts, relative to that of the motion without contact",
                number,
                DEFAULT_SPREAD,
            ),
            shared_option("--seed", help="seed of the starts"),
            shared_option("--most-periods", default=1024),
            "--out",
        ),
        arguments=("starts", "spread", "seed", "most_periods"),
        files=("attractors.nc", "attractors.png", "summary.json"),
        module="orbits",
    ),
    "basins": Command(
        "Draw which motion each start of a plane ends on.",
        'jaxshroud basins fig10b --plane "x[0],v_x[0]" --num 100 --out basins',
        (
            *SIMULATION,
            Option("--plane", "two numbers of the initial motion", default="x[0],v_x[0]", metavar="A,B"),
            Option("--start", "where their ranges begin, e.g. --start=-1mm,-0.5", metavar="A,B"),
            Option("--stop", "where their ranges end", metavar="A,B"),
            Option("--num", "values of each", count(2), 100, metavar="N"),
            shared_option("--most-periods", default=512),
            "--out",
        ),
        arguments=("num", "most_periods"),
        files=("basins.nc", "basins.png", "summary.json"),
        module="orbits",
    ),
    "trade": Command(
        "Measure accuracy against cost on a scene of your own.",
        "jaxshroud trade table1 --out trade",
        (
            *SCENE_FLAGS,
            "--force",
            shared_option("--transient", help="periods discarded before P_d is averaged"),
            Option("--lanes", "scenes scattered around the scene", count(8), 64, metavar="N"),
            shared_option("--seed", help="seed of the scattering"),
            "--out",
        ),
        arguments=("n_periods", "transient", "lanes", "seed"),
        files=("trade.json", "trade.png"),
        unit="settings",
        module="runs",
    ),
    "explain": Command(
        "Say what the model of a scene consists of, what it lacks and what it costs.",
        'jaxshroud explain table1 --set \'parts.motion=["x", "y"]\'',
        SIMULATION,
        module="describe",
    ),
    "check": Command(
        "Print a scene's data sheet: natural frequencies, engine orders, amplitudes against the gap, and doubts.",
        "jaxshroud check table1",
        (
            *SCENE_FLAGS,
            Option(
                "--engine-orders",
                "orders whose crossings with natural frequencies are told; by default the scene's own and 1 to 6",
                engine_orders,
                metavar="A,B,C",
            ),
            Option("--start", "where the range of speeds begins, e.g. 500rpm", speed, 0.0, metavar="SPEED"),
            Option("--stop", "where it ends", speed, metavar="SPEED"),
            shared_option("--out", help="write the data sheet and the Campbell diagram there", required=None),
            "--force",
        ),
        arguments=("engine_orders", "start", "stop"),
        files=("check.nc", "check.json", "check.png"),
        module="describe",
    ),
    "plot": Command(
        "Draw stored results again, without simulating.",
        "jaxshroud plot fig09",
        (
            Option("source", type=path, metavar="DIR|FILE"),
            Option("--kind", "picture of a run, by default its motion; or of a sweep", choices=PICTURE_KINDS),
            shared_option("--title", help='in place of the result\'s own; "" for none'),
            Option("--xlabel", metavar="TEXT"),
            Option("--unit", "unit of displacements and swept lengths; gap: x divided by the gap", choices=UNITS),
            Option("--width", "width of the picture, e.g. 90mm", width, metavar="LENGTH"),
            Option("--format", "file format; by default that of --out, or png", choices=("png", "pdf", "svg")),
            Option("--style", "matplotlib style, applied after the package's own", metavar="FILE.mplstyle"),
            shared_option("--out", help="by default beside the result", metavar="PICTURE", required=None),
            shared_option("--force", help="replace a picture named by --out"),
        ),
        module="stored_results",
    ),
    "convert": Command(
        "Write a stored result as CSV, MATLAB or NetCDF file.",
        "jaxshroud convert gap/sweep.nc --out gap.csv",
        (
            Option("source", type=path, metavar="FILE.nc"),
            Option(
                "--rows",
                "what a row of the table is; by default lanes if there are many, else samples",
                choices=("lane", "sample"),
            ),
            shared_option("--out", help="ends in .csv, .mat or .nc", metavar="FILE"),
            shared_option("--force", help="replace an existing file"),
        ),
        module="stored_results",
    ),
    "animate": Command(
        "Show a stored run as a moving picture.",
        "jaxshroud animate run.nc --out run.gif",
        (
            Option("source", "a run that `simulate` has stored", path, metavar="FILE.nc"),
            shared_option("--periods", help="periods shown; by default those of the motion"),
            Option("--factor", "factor by which motion and gap are exaggerated", positive, metavar="X"),
            shared_option("--title", help='in place of the run\'s own; "" for none'),
            shared_option("--out", help="mp4 needs ffmpeg", metavar="FILE.gif|FILE.mp4"),
            shared_option("--force", help="replace an existing file"),
        ),
        module="stored_results",
    ),
    "scenes": Command("List the shipped scenes.", "jaxshroud scenes", module="describe"),
}
