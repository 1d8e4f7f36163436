"""What every verb answers for every kind of scene, each at the smallest size; the page that shows it.

    python tests/verbs_and_scenes.py SCENE,SCENE|all [VERB ...]

asks verbs, by default all, for scenes, keeps their answers beside those that are kept already, and writes the page.
"""

import io
import json
import sys
import tempfile
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import chdir, redirect_stderr, redirect_stdout
from itertools import combinations
from pathlib import Path
from typing import NamedTuple

import jax

import jaxshroud as js
from jaxshroud.cli import commands

ANSWERS = Path(__file__).with_suffix(".json")
PAGE = Path(__file__).parent.parent / "docs" / "verbs_and_scenes.md"
DONE = "done"


class Kind(NamedTuple):
    """A kind of scene, by its properties."""

    layout: str
    motion: str
    contact: str
    drive: str
    loads: str
    coupling: str
    blades: str

    @property
    def by_file(self) -> bool:
        """Whether a scene file says it all, so that commands can be asked."""
        return self.contact != "own law"


# Every pair of values of two properties that a scene may have is in one of these.
SCENES = {
    "P1": Kind("pair", "x, y, theta", "springs", "phases", "none", "none", "alike"),
    "P2": Kind("pair", "x", "springs", "two orders", "none", "none", "unlike"),
    "P3": Kind("pair", "x", "smooth", "engine order", "interference", "none", "unlike"),
    "P4": Kind("pair", "x", "none", "engine order", "none", "none", "alike"),
    "P5": Kind("pair", "x, y", "points", "phases", "none", "springs", "unlike"),
    "P6": Kind("pair", "x, y", "none", "two orders", "mean loads", "none", "unlike"),
    "P7": Kind("pair", "x, y, theta", "none", "phases", "none", "none", "alike"),
    "P8": Kind("pair", "x", "own law", "phases", "none", "none", "alike"),
    "P9": Kind("pair", "x, y, theta", "springs", "phases", "none", "none", "modes"),
    "C1": Kind("chain", "x", "points", "engine order", "mean loads", "none", "alike"),
    "C2": Kind("chain", "x, y", "springs", "phases", "interference", "flow", "modes"),
    "C3": Kind("chain", "x, y, theta", "springs", "two orders", "interference", "springs", "unlike"),
    "C4": Kind("chain", "x, y, theta", "smooth", "engine order", "none", "none", "modes"),
    "R1": Kind("ring", "x", "smooth", "phases", "none", "none", "modes"),
    "R2": Kind("ring", "x", "points", "engine order", "interference", "flow", "alike"),
    "R3": Kind("ring", "x, y", "springs", "phases", "mean loads", "flow", "unlike"),
    "R4": Kind("ring", "x, y", "smooth", "engine order", "none", "flow", "unlike"),
    "R5": Kind("ring", "x, y, theta", "points", "two orders", "mean loads", "springs", "modes"),
    "S1": Kind("ring by its sector", "x", "smooth", "engine order", "interference", "springs", "alike"),
    "S2": Kind("ring by its sector", "x, y", "springs", "engine order", "interference", "none", "alike"),
    "S3": Kind("ring by its sector", "x, y", "smooth", "two orders", "mean loads", "flow", "alike"),
    "S4": Kind("ring by its sector", "x, y, theta", "points", "engine order", "none", "flow", "alike"),
}
BLADES = {"pair": 2, "chain": 2, "ring": 3, "ring by its sector": 4}


def may_be(kind: dict[str, str]) -> bool:
    """Whether a scene may have all of some properties."""
    layout, contact, coupling, blades = (kind.get(name) for name in ("layout", "contact", "coupling", "blades"))
    if contact == "none" and (
        layout not in (None, "pair") or coupling not in (None, "none") or kind.get("loads") == "interference"
    ):
        return False
    if layout == "pair" and coupling == "flow":
        return False
    if blades == "modes" and contact == "none":
        return False
    return not (layout == "ring by its sector" and (kind.get("drive") == "phases" or blades not in (None, "alike")))


def missing_pairs() -> list[dict[str, str]]:
    """The pairs of values that a scene may have, but none of `SCENES` has; a law of one's own is tried once."""
    values = {name: dict.fromkeys(getattr(kind, name) for kind in SCENES.values()) for name in Kind._fields}
    del values["contact"]["own law"]
    pairs = [{a: x, b: y} for a, b in combinations(Kind._fields, 2) for x in values[a] for y in values[b]]
    kinds = [kind._asdict() for kind in SCENES.values()]
    return [pair for pair in pairs if may_be(pair) and not any(pair.items() <= kind.items() for kind in kinds)]


MODES = [  # those of the lumped blades, each of which moves the shroud a little in the other coordinates
    line
    for f, zeta, shape in (
        (178.0, 0.22, (3.5, -0.3, 7.0)),
        (308.0, 0.19, (0.4, 3.5, -3.5)),
        (142.0, 0.22, (1.2, 0.6, 63.0)),
    )
    for line in (
        *("[[blades.modes]]", f"f = {f}", f"zeta = {zeta}"),
        *map("phi_{} = {}".format, ("x", "y", "theta"), shape),
    )
]


def scene_text(kind: Kind) -> str:
    """The scene as a file; laws of one's own are put in afterwards."""
    n = BLADES[kind.layout]
    is_row = kind.layout != "pair"
    is_ring = "ring" in kind.layout
    unlike = kind.blades == "unlike"
    lines = [f"title = 'a {kind.layout}'"]
    if is_row:
        lines += ["[row]", f"blades = {n}", f"closed = {str(is_ring).lower()}"]
        lines += ["sector = 'auto'"] if "sector" in kind.layout else []
    if kind.coupling == "springs":
        lines += ["[coupling]", "k_x = 2e4", "c_x = 1.0"]
    if kind.coupling == "flow":
        lines += ["[row.aero]", "L0 = [0, 500]", "L1 = [-100, 50]", "L_1 = [100, 50]"]
    mass = [0.08, 0.082, 0.079, 0.081][:n] if unlike else 0.08
    if kind.blades == "modes":
        lines += MODES
    else:
        lines += ["[blades]", f"m = {mass}", "I = 2.5e-4", "k_x = 1e5", "k_y = 3e5", "k_T = 200", "c_x = 40"]
        lines += ["c_y = 60", "c_T = 0.1"]
    lines += ["[shroud]", "alpha = '60 deg'", "l_oa = 0.05", "l_ab = 0.035"]
    lines += [f"gap = {-2e-5 if kind.loads == 'interference' else 2e-5}", "[contact]", "gamma = 1.5"]
    lines += {"smooth": ["width = '0.2 mm'"], "points": ["points = 2"]}.get(kind.contact, [])
    lines += ["[friction]", "k_d = 1e5", "mu = 0.5", "[drive]"]
    if kind.drive == "phases":
        lines += ["omega = 1000", f"phase = {[2 * i for i in range(n)]}"]
    else:
        lines += ["speed = '4800 rpm'"] + ([] if is_row else ["phase = [0, 3]"])
        lines += ["engine_order = 2"] if kind.drive == "engine order" else []
    if kind.loads == "mean loads":
        lines += ["F_x_mean = 5"]
    if kind.drive == "two orders":
        for order, force in ((2, 40), (4, 10)):
            lines += ["[[drive.harmonic]]", f"engine_order = {order}", f"F = {force}", "beta = '30 deg'"]
    else:
        lines += ["F_0 = 40", "M_0 = 0", "beta = '30 deg'"]
    if kind.loads == "interference" and kind.contact != "smooth" and kind.blades != "modes":
        lines += ["[initial]", "start = 'static'"]
    lines += ["[parts]", f"motion = [{', '.join(repr(q) for q in kind.motion.split(', '))}]"]
    lines += [f"contact = '{kind.contact}'"] if kind.contact in ("smooth", "none") else []
    return "\n".join([*lines, "[run]", "periods = 4", "transient = 8", ""])


def python_scene(kind: Kind, file: Path) -> js.Scene:
    """The scene of a kind that no file gives."""
    return js.with_contact_law(js.load(file).scene, js.Laws(js.Hertz(1e7)))


STEPS = ["--tableau", "rk4", "--steps-per-period", "80"]
OVER_SPEED = ["--along", "drive.omega", "--start", "995", "--stop", "1010"]
COMMANDS: dict[str, list[str]] = {
    "check": ["scene.toml", "--out", "check"],
    "explain": ["scene.toml", *STEPS],
    "simulate": ["scene.toml", *STEPS, "--periods", "2", "--out", "run.nc"],
    "plot": ["run.nc", "--dpi", "40"],
    "animate": ["run.nc", "--periods", "1", "--dpi", "30", "--out", "run.gif"],
    "convert": ["run.nc", "--out", "run.csv"],
    "explore": ["scene.toml", "--out", "page.html"],
    "sweep": ["scene.toml", *STEPS, *OVER_SPEED, "--num", "2", "--forces", "--amplitudes", "--out", "sweep"],
    "table": ["designs.csv", "--scene", "scene.toml", *STEPS, "--out", "table.csv"],
    "power": ["scene.toml", *STEPS, "--out", "power"],
    "diagnose": ["scene.toml", *STEPS, "--out", "diagnose"],
    "orbit": ["scene.toml", *STEPS, "--most-periods", "64", "--out", "orbit"],
    "lyapunov": ["scene.toml", *STEPS, "--out", "lyapunov"],
    "branch": ["scene.toml", *STEPS, *OVER_SPEED, "--num", "2", "--most-points", "2", "--out", "branch"],
    "response": ["scene.toml", *STEPS, *OVER_SPEED, "--num", "2", "--most-points", "2", "--out", "response"],
    "attractors": ["scene.toml", *STEPS, "--starts", "2", "--most-periods", "64", "--out", "attractors"],
    "basins": ["scene.toml", *STEPS, "--num", "2", "--most-periods", "64", "--out", "basins"],
    "gradient": ["scene.toml", *STEPS, "--wrt", "blades.c_x,drive.omega", "--pairs", "4", "--out", "gradient.json"],
    "tune": [
        *["scene.toml", *STEPS, "--over", "blades.c_x=40:80", "--scan", "2", "--starts", "1", "--updates", "1"],
        *["--motions", "2", "--out", "tune"],
    ],
    "scatter": ["scene.toml", *STEPS, "--spread", "blades.c_x=20%", "--samples", "4", "--out", "scatter"],
    "report": [
        *["scene.toml", *STEPS, "--spread", "blades.c_x=20%", "--samples", "4", "--starts", "2"],
        *["--out", "report.html"],
    ],
    "mistune": ["scene.toml", *STEPS, *OVER_SPEED, "--num", "2", "--n-patterns", "2", "--out", "mistune"],
    "fit": [
        *["scene.toml", "measured.csv", *STEPS, "--over", "blades.c_x=30:60", "--scan", "2", "--starts", "1"],
        *["--most-periods", "64", "--out", "fit"],
    ],
    "trade": ["scene.toml", "--transient", "4", "--lanes", "8", "--out", "trade"],
}
OF_MODES = {  # in the place of these words
    "blades.c_x,drive.omega": "blades.modes[0].zeta,drive.omega",
    "blades.c_x=20%": "blades.modes[0].zeta=20%",
    "blades.c_x=40:80": "blades.modes[0].zeta=0.2:0.3",
    "blades.c_x=30:60": "blades.modes[0].zeta=0.2:0.3",
}
DESIGNS = {"modes": "blades.modes[0].zeta\n0.2\n0.3\n"}
USUAL_DESIGNS = "blades.c_x [N s/m]\n40\n50\n"
MEASURED = "t [ms],x_1 [mm]\n1,0.01\n2,0.04\n3,0.09\n4,0.12\n"


def command_answer(words: list[str]) -> str:
    """What a command answers: "done", or its line and its exit status."""
    said = io.StringIO()
    with redirect_stdout(io.StringIO()), redirect_stderr(said):
        status = commands.main(words)
    lines = said.getvalue().splitlines()
    stopped = [line for line in lines if "runs stopped" in line]
    if status == 0:
        return "; ".join([DONE, *stopped])
    return f"{status}: {lines[-1]}"


METHOD = js.RungeKutta("rk4", steps=80)
SPEEDS = {"drive.omega": [995.0, 1010.0]}
SHORT = {"n_periods": 4, "transient": 8, "method": METHOD}
IN_PYTHON: dict[str, Callable[[js.Scene], object]] = {
    "check": js.check,
    "explain": lambda scene: js.explain(scene, method=METHOD),
    "simulate": lambda scene: js.simulate(scene, n_periods=2, method=METHOD),
    "sweep": lambda scene: js.sweep(scene, SPEEDS, forces=True, amplitudes=True, **SHORT),
    "table": lambda scene: js.table(scene, {"blades.c_x": [40.0, 50.0]}, **SHORT),
    "power": lambda scene: js.power(scene, **SHORT),
    "diagnose": lambda scene: js.diagnose(scene, method=METHOD),
    "orbit": lambda scene: js.orbit(scene, most_periods=64, method=METHOD),
    "lyapunov": lambda scene: js.lyapunov(scene, **SHORT),
    "branch": lambda scene: js.branch(scene, "drive.omega", 995.0, 1010.0, most_points=2, method=METHOD),
    "response": lambda scene: js.response(scene, "drive.omega", 995.0, 1010.0, num=2, most_points=2, **SHORT),
    "attractors": lambda scene: js.attractors(scene, 2, most_periods=64, method=METHOD),
    "basins": lambda scene: js.basins(scene, num=2, most_periods=64, method=METHOD),
    "gradient": lambda scene: js.gradient(scene, ["blades.c_x", "drive.omega"], pairs=4, **SHORT),
    "tune": lambda scene: js.tune(
        scene, {"blades.c_x": (40.0, 80.0)}, search=js.SearchOptions(2, 1, 1), motions=2, **SHORT
    ),
    "scatter": lambda scene: js.scatter(scene, {"blades.c_x": "20%"}, draws=4, **SHORT),
    "report": lambda scene: js.report(scene, scatters={"blades.c_x": "20%"}, draws=4, starts=2, **SHORT),
    "mistune": lambda scene: js.mistune(scene, SPEEDS, n_patterns=2, **SHORT),
    "fit": lambda scene: js.fit(
        scene,
        {"t [s]": [1e-3, 2e-3, 3e-3], "x_1 [m]": [1e-5, 4e-5, 9e-5]},
        {"blades.c_x": (30.0, 60.0)},
        scan=2,
        starts=1,
        most_periods=64,
        method=METHOD,
    ),
    "trade": lambda scene: js.trade(scene, n_periods=4, transient=4, lanes=8),
}


def python_answer(verb: str, scene: js.Scene) -> str:
    """What a verb of Python answers: "done", or its line."""
    try:
        with warnings.catch_warnings(action="ignore"):  # of runs so short
            IN_PYTHON[verb](scene)
    except js.Error as error:
        return f"{'2' if isinstance(error, js.InputError) else '1'}: {' '.join(str(error).split())}"
    return DONE


OF_RUNS = ("plot", "animate", "convert")  # of which a run is needed


def answers_of(name: str, verbs: Iterable[str]) -> Iterator[tuple[str, str]]:
    """Verbs and what each answers for a scene."""
    kind = SCENES[name]
    with tempfile.TemporaryDirectory() as folder, chdir(folder):
        file = Path("scene.toml")
        file.write_text(scene_text(kind), "utf-8")
        Path("designs.csv").write_text(DESIGNS.get(kind.blades, USUAL_DESIGNS), "utf-8")
        Path("measured.csv").write_text(MEASURED, "utf-8")
        scene = None if kind.by_file else python_scene(kind, file)
        for verb in verbs:
            if verb in OF_RUNS and not Path("run.nc").exists():
                command_answer(["simulate", *COMMANDS["simulate"]])
            words = [OF_MODES.get(word, word) if kind.blades == "modes" else word for word in COMMANDS[verb]]
            yield verb, command_answer([verb, *words]) if scene is None else python_answer(verb, scene)


def stored_answers() -> dict[str, dict[str, str]]:
    """The answers that are kept, by scene and verb."""
    return json.loads(ANSWERS.read_text("utf-8")) if ANSWERS.exists() else {}


def keep(answers: Mapping[str, Mapping[str, str]]) -> None:
    """Write the answers in the order of scenes and commands."""
    ordered = {
        name: {verb: answers[name][verb] for verb in COMMANDS if verb in answers[name]}
        for name in SCENES
        if name in answers
    }
    ANSWERS.write_text(json.dumps(ordered, indent=1, ensure_ascii=False) + "\n", "utf-8")


PREAMBLE = """# What every verb does for every kind of scene

Verbs were run for each of these scenes at the smallest size: two to four blades, coarse steps, a few periods.
Any two values of two properties that one scene may have occur together in one of them. The table says whether a verb
comes to an end, not how good its numbers are: that is on the pages of the verbs, and of [limits](limits.md). What an
empty cell stands for was not run.
`pytest --full tests/test_verbs_and_scenes.py` computes the answers anew.

## The scenes
"""
BETWEEN = """
Blades by modes have three modes each. Unlike blades differ in mass. Phases are those of no engine order.

## The answers

A dot: done. A number: the limit of that number below. Empty: not tried. Laws of a user are given in
Python, where there are no commands such as `plot`; what takes long was tried for some scenes only.
"""


def page(answers: Mapping[str, Mapping[str, str]]) -> str:
    """The page of the answers: the scenes, a table of verbs by scenes, and the limits with their numbers."""
    names = [name for name in SCENES if name in answers]
    scenes = [["scene", *Kind._fields], *([name, *SCENES[name]] for name in names)]
    limits: dict[str, int] = {}
    rows = [["verb", *names]]
    for verb in COMMANDS:
        cells = [answers[name].get(verb, "") for name in names]
        numbers = [
            cell if cell in ("", DONE) else str(limits.setdefault(_limit_text(cell), len(limits) + 1)) for cell in cells
        ]
        rows.append([f"[{verb}](verbs/{verb}.md)", *("•" if cell == DONE else cell for cell in numbers)])
    numbered = [f"{number}. {limit}" for limit, number in limits.items()]
    return "\n".join([PREAMBLE, *_table(scenes), BETWEEN, *_table(rows), "\n## The limits\n", *numbered, ""])


def _table(rows: list[list[str]]) -> list[str]:
    head, *others = (f"| {' | '.join(row)} |" for row in rows)
    return [head, f"|{'---|' * len(rows[0])}", *others]


def _limit_text(answer: str) -> str:
    """An answer as the page has it: the line without the file, and its exit status unless that is 2, wrong input."""
    status, _, line = answer.partition(": ")
    text = line.removeprefix("scene.toml: ").removeprefix("run.nc: ")
    return text if status == "2" else f"(status {status}) {text}"


def main(names: str, *verbs: str) -> None:
    """Ask verbs, by default all, for scenes with commas between them, or `all`; each answer is kept at once."""
    jax.config.update("jax_enable_x64", True)
    answers = stored_answers()
    for name in SCENES if names == "all" else names.split(","):
        known = answers.setdefault(name, {})
        possible = COMMANDS if SCENES[name].by_file else IN_PYTHON
        for verb, answer in answers_of(name, [verb for verb in possible if verb in (verbs or possible)]):
            known[verb] = answer
            keep(answers)
            print(name, verb, answer, flush=True)
    PAGE.write_text(page(answers), "utf-8")


if __name__ == "__main__":
    main(*sys.argv[1:])
