"""Which tests catch faults that are planted on purpose, one line each: before tests are taken out, and after.

    python tests/studies/planted_faults.py [NAME ...] [--whole] --write planted_faults.json

Each fault replaces a text that occurs once in a file of the package. In a clone of the commit the tests of its `tests`
run with it, those of README's command first, then, if none of them fails, those of `--full`; with `--whole` all of the
README's command before these. What is found is the first of "README", "full" and "nothing" that catches it, and by
which test.
"""

import argparse
import json
import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[2]
STORED = Path(__file__).with_suffix(".json")
FAILED = re.compile(r"^(?:FAILED|ERROR) (\S+)", re.MULTILINE)
LIMIT_SECONDS = 1800  # of one call of pytest


class Fault(NamedTuple):
    """A text of the package, and a wrong one in its place."""

    file: str  # in the package
    right: str
    wrong: str
    tests: str  # files or folders of `tests` that look at it first, with spaces between them


CONTACT = "model/test_contact.py model/test_friction.py model/test_geometry.py march/test_events.py march/test_march.py"
ROWS = "model/test_coupling.py march/test_rows.py march/test_coupled_march.py"
EXTREMES = "march/test_extremes.py march/test_row_log.py march/test_loads.py signals"
FAULTS = {
    # the article's equations
    "friction pulls along": Fault(
        "model/spring_contact.py",
        "return where(mode == Mode.STICK, self.k_d * (u - u_s), slipping)",
        "return where(mode == Mode.STICK, self.k_d * (u_s - u), slipping)",
        CONTACT,
    ),
    "slip begins the other way": Fault(
        "model/spring_contact.py", "slip_mode(rate.u < 0)", "slip_mode(rate.u > 0)", CONTACT
    ),
    "stick ends the other way": Fault(
        "model/spring_contact.py",
        "slip_mode(crossing.at.u < crossing.u_s)",
        "slip_mode(crossing.at.u > crossing.u_s)",
        CONTACT,
    ),
    "the slider leaves out the normal force": Fault(
        "model/spring_contact.py",
        "u_rate - sigma * (self.lag * v_rate)",
        "u_rate + 0 * sigma * (self.lag * v_rate)",
        CONTACT,
    ),
    "energy of the friction spring is lost": Fault(
        "model/spring_contact.py",
        "(self.k * v * v + self.k_d * w * w) / 2",
        "(self.k * v * v + 0 * self.k_d * w * w) / 2",
        CONTACT,
    ),
    "action without reaction": Fault("model/row.py", "(load.R_x, -load.R_x)", "(load.R_x, load.R_x)", CONTACT),
    "the face does not turn": Fault(
        "model/geometry.py", "lean * cos_A - w_face * at.u", "lean * cos_A + w_face * at.u", CONTACT
    ),
    "corners lean to the left": Fault(
        "model/geometry.py", "lean = shroud.l_ab * cos_alpha / 2", "lean = -shroud.l_ab * cos_alpha / 2", CONTACT
    ),
    "a corner turns backwards": Fault(
        "model/geometry.py", "return py * s - px * versine", "return -py * s - px * versine", CONTACT
    ),
    "half of the gyration": Fault(
        "model/geometry.py",
        "(l_oa**2 + l_ab**2) / 12",
        "(l_oa**2 + l_ab**2) / 24",
        "model/test_linear.py model/test_geometry.py",
    ),
    "the tip on the wrong side": Fault(
        "model/geometry.py", "where(upper, height < 0, height > 0)", "where(upper, height > 0, height < 0)", CONTACT
    ),
    "torsion half in the power": Fault(
        "model/rhs.py",
        "gyration * 2 * versine",
        "gyration * versine",
        "model/test_linear.py",
    ),
    "a harmonic of the wrong order": Fault(
        "model/drive.py", "for _ in range(n - 1):", "for _ in range(n):", "model/test_several_harmonics.py"
    ),
    "P_d upside down": Fault(
        "model/linear.py",
        "100 * (1 - P / where(driven, P_0, 1.0))",
        "100 * (P / where(driven, P_0, 1.0) - 1)",
        "model/test_linear.py signals",
    ),
    "area of a rectangle": Fault(
        "model/linear.py",
        "shroud.l_oa * shroud.l_ab * jnp.sin(shroud.alpha)",
        "shroud.l_oa * shroud.l_ab",
        "model/test_linear.py march/test_quadrature.py",
    ),
    # events
    "no event at the tip": Fault(
        "march/events.py",
        "return now.of_corners[1]",
        "return Guard(*(0 * a - 1 for a in now.of_corners[1]))",
        "march/test_events.py march/test_march.py",
    ),
    "flat faces never": Fault(
        "march/events.py",
        "returns < time * -lower * upper",
        "returns < -time * -lower * upper",
        "march/test_flat.py march/test_events.py",
    ),
    "the shift of an event's time": Fault(
        "march/locate.py",
        "shift = -tangents[2] / rate",
        "shift = tangents[2] / rate",
        "batch/test_tangents.py orbits/test_orbit.py",
    ),
    "slides begin late": Fault(
        "model/spring_contact.py",
        "return at.u - rate.u * where(closing",
        "return at.u + rate.u * where(closing",
        "march/test_events.py march/test_march.py model/test_friction.py",
    ),
    "largest penetration at the ends of a step": Fault(
        "march/extremes.py",
        "deepest = where(inside, jnp.maximum(top, v_1), v_1)",
        "deepest = v_1 + 0 * top",
        EXTREMES,
    ),
    "a peak of a displacement at the ends of a step": Fault(
        "march/extremes.py",
        "return extent_of(a, b, where(turns, cubic(s), b))",
        "return extent_of(a, b, where(turns, b, b))",
        EXTREMES,
    ),
    # rows
    "a row's springs pull on one side": Fault(
        "model/coupling.py",
        "is_zero(a) else sum_at_blades(a, -a, closed)",
        "is_zero(a) else sum_at_blades(a, a, closed)",
        ROWS,
    ),
    "the flow from the other neighbour": Fault(
        "model/coupling.py", "(aero.next, -1), (aero.before, 1)", "(aero.next, 1), (aero.before, -1)", ROWS
    ),
    "the last interface of a ring": Fault(
        "model/arithmetic.py",
        "lambda a: jnp.roll(a, -1, 0) if closed else a[1:], a",
        "lambda a: jnp.roll(a, 1, 0) if closed else a[1:], a",
        ROWS,
    ),
    "the springs of a matrix": Fault(
        "model/linear_system.py",
        "spring_stiffness(k.reshape(*lanes, -1), D)",
        "spring_stiffness(k.reshape(*lanes, -1), abs(D))",
        "model/test_coupling.py verbs/test_linear_rows.py",
    ),
    # numbers of results
    "a mean in an RMS": Fault(
        "signals/amplitudes.py",
        "np.sqrt(np.maximum(square[i] - mean[i] ** 2, 0.0))",
        "np.sqrt(np.maximum(square[i], 0.0))",
        "signals verbs/test_free_motion.py verbs/test_linear_rows.py",
    ),
    "a peak from zero": Fault(
        "signals/amplitudes.py",
        "np.maximum(highest[i] - mean[i], mean[i] - lowest[i])",
        "np.maximum(highest[i], -lowest[i])",
        "signals verbs/test_free_motion.py verbs/test_linear_rows.py",
    ),
    "the first orbits count": Fault(
        "signals/amplitudes.py",
        "np.arange(n) >= (n - n // q * q)[:, None]",
        "np.arange(n) < (n // q * q)[:, None]",
        "signals verbs/test_free_motion.py verbs/test_forces.py",
    ),
    "intervals half as wide": Fault(
        "signals/statistics.py",
        "np.asarray(means.std(axis=-1, ddof=1) / np.sqrt(batches))",
        "np.asarray(means.std(axis=-1, ddof=1) / batches)",
        "signals",
    ),
    "drifting motions have settled": Fault(
        "signals/period.py", "(shrinks > STEADY_RATIO) & (spans", "(spans", "signals/test_period.py verbs/test_every.py"
    ),
    "multipliers transposed": Fault(
        "orbits/orbit.py",
        "return M * units / units[:, None]",
        "return M * units[:, None] / units",
        "orbits/test_orbit.py",
    ),
    "Newton's step without the identity": Fault(
        "orbits/shooting.py",
        "np.linalg.lstsq(np.eye(len(moves)) - M[np.ix_(moves, moves)]",
        "np.linalg.lstsq(-M[np.ix_(moves, moves)]",
        "orbits/test_orbit.py",
    ),
    "wear without friction's number": Fault(
        "signals/amplitudes.py",
        "if own else work / mu",
        "if own else work * mu",
        "signals march/test_loads.py verbs/test_forces.py verbs/test_row_forces.py",
    ),
    # files and commands
    "a key's range": Fault(
        "scene/keys.py", 'blade_key("blades.c_x", "N s/m", FROM_0,', 'blade_key("blades.c_x", "N s/m", ANY,', "scene"
    ),
    "revolutions per second": Fault("scene/units.py", '("rad/s", "rpm"): PI / 30', '("rad/s", "rpm"): PI * 2', "scene"),
    "the gap at speed": Fault(
        "scene/speed.py", "return gap + (at - gap) * share", "return gap + at * share", "model/test_speed.py"
    ),
    "stiffening by the mass of x": Fault(
        "scene/speed.py",
        '"blades.B_T": ("k_T", "I")',
        '"blades.B_T": ("k_T", "m")',
        "model/test_speed.py",
    ),
    "wrong input has status 1": Fault(
        "cli/commands.py",
        "status = 2",
        "status = 1",
        "cli/test_commands.py",
    ),
    "a resumed block again": Fault(
        "verbs/stored.py",
        "if record is not None:\n                finished =",
        "if record is not None and not values:\n                finished =",
        "verbs/test_stored.py",
    ),
    "slip takes no energy": Fault(
        "model/spring_contact.py",
        "return forces.F * self.slider_speed(rate.v, rate.u, point.mode)",
        "return 0 * forces.F * self.slider_speed(rate.v, rate.u, point.mode)",
        CONTACT,
    ),
}


class Caught(NamedTuple):
    """What catches a fault."""

    by: str  # "README", "full" or "nothing"
    test: str


def caught(fault: Fault, clone: Path, cache: Path, *, whole: bool) -> Caught:
    """What catches a fault that is planted in a clone meanwhile."""
    path = clone / "jaxshroud" / fault.file
    source = path.read_text()
    assert source.count(fault.right) == 1, f"{fault.file}: {fault.right!r} occurs {source.count(fault.right)} times"
    path.write_text(source.replace(fault.right, fault.wrong))
    first = [f"tests/{name}" for name in fault.tests.split()]
    try:
        for by, arguments in (("README", first), *([("README", [])] if whole else []), ("full", ["--full", *first])):
            test = _failing_test(clone, cache, arguments)
            if test:
                return Caught(by, test)
        return Caught("nothing", "")
    finally:
        path.write_text(source)


def _failing_test(clone: Path, cache: Path, arguments: Sequence[str]) -> str:
    """The first failing test of a call of pytest; empty if none fails."""
    environment = os.environ | {
        "PYTHONPATH": str(clone),
        "JAX_COMPILATION_CACHE_DIR": str(cache),
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
    }
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-n", "1", "-p", "no:cacheprovider", *arguments]
    try:
        done = subprocess.run(
            command, cwd=clone, env=environment, capture_output=True, text=True, timeout=LIMIT_SECONDS, check=False
        )
    except subprocess.TimeoutExpired:
        return "no test: it did not end"
    failed = FAILED.search(done.stdout)
    assert failed or done.returncode in (0, 5), done.stdout[-2000:] + done.stderr[-2000:]
    return failed[1] if failed else ""


def main() -> None:
    """Plant the faults of these names, or all of them, one after the other."""
    options = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    options.add_argument("names", nargs="*", metavar="NAME")
    options.add_argument("--whole", action="store_true", help="all of the README's command before --full")
    options.add_argument("--write", type=Path, default=STORED)
    given = options.parse_args()
    found = json.loads(given.write.read_text()) if given.write.exists() else {}
    with tempfile.TemporaryDirectory() as folder:
        clone, cache = Path(folder, "clone"), Path(folder, "compiled")
        subprocess.run(["git", "clone", "--quiet", str(ROOT), str(clone)], check=True)
        for name in given.names or FAULTS:
            found[name] = caught(FAULTS[name], clone, cache, whole=given.whole)._asdict()
            print(f"{name}: {found[name]['by']} {found[name]['test']}", flush=True)
            given.write.write_text(json.dumps(found, indent=1) + "\n")


if __name__ == "__main__":
    main()
