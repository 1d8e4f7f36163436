"""The numbers of a scene as a page of the documentation.

`python tests/keys.py` writes it anew; a test compares.
"""

from pathlib import Path

from jaxshroud.scene.keys import (
    ALL_KEYS,
    COMPLEX_KEYS,
    HARMONIC_KEYS,
    INPUT_KEYS,
    MAX_BLADES,
    MIN_BLADES,
    ROW_KEYS,
    SCENE_KEYS,
    Key,
)
from jaxshroud.scene.optional import WITHOUT_EFFECT

FILE = Path(__file__).parent.parent / "docs" / "keys.md"
HEAD = """# The numbers of a scene

A file gives a number in its table, `[shroud] gap = "0.022 mm"`, in SI units or as a string with a unit; `--set`,
`--along` and `jaxshroud.vary` call it by its key, `shroud.gap`. What is there per blade is one number for alike blades
or a pair `[left, right]`; `blades.m[0]` is the left blade's alone. Exactly one of `contact.k` and `contact.gamma` is
given. What is there per interface is one number for the two blades of a pair, which have one interface, and one number
or a list in a [row of blades](#rows-of-blades). Lists have brackets wherever they are written,
`--set 'drive.beta=[10 deg, 0.5]'`, and the decimal mark is a point: `3,57` is refused.
In SI units no number is larger than 1e30, and what is > 0 is at least 1e-30.

| key | symbol | unit | range | per | default | example | |
|---|---|---|---|---|---|---|---|
"""
MORE = """
`[contact] points` is no number of the scene: a whole number from 2 to 16, or a list of places up the face from its
middle, with a list of `shares`, makes the faces touch at
[several points](model.md#faces-with-several-points-of-contact). A listed place is a number of its own,
`contact.point[0].place` [m] for the first one, which can be set, varied, differentiated and fitted like all others.

## Data as engineers have them

A file may give frequencies, damping ratios and speeds instead, from which these numbers are worked out
(formulas: `jaxshroud/scene/derived_inputs.py`), and `I = "block"` for the moment of inertia of the block
itself. Two keys for one quantity are an error. These are keys like all others: `--set`, `--along`, `--over`, `--range`,
`--wrt`, `--tolerance` and `jaxshroud.vary` take them, and `--along K` makes for each value, bit for bit, the scene that
`--set K=value` makes; [how it is marched](verbs/sweep.md#one-value-and-its-neighbours) may depend on the other values.
A scene remembers what it is given by: where `blades.m` changes, a scene that is given by `f_x`
and `zeta_x` keeps these, and `k_x` and `c_x` follow. Numbers that are replaced in Python without `vary` are simply
numbers: the inputs that no longer give them do not count.

A speed needs an engine order. At the speed Omega = omega / e of the rotor the stiffnesses are k_x + B_x m Omega^2,
k_y + B_y m_y Omega^2 and k_T + B_T I Omega^2, and the gap is gap + (gap_at - gap) (Omega / gap_at_speed)^2. `k_x` and
its like, `gamma`, `f_x`, `zeta_x` and mistuning refer to the blade at rest, and dampers stay as they are. These numbers
need an engine order, which in a pair may then stand beside `omega` or `f`; in a row it also gives the phases, which
cannot be replaced by others. For `drive.omega` of a scene with an engine order, `"1300 rpm"` is an error: name
`drive.speed`.

| key | symbol | unit | range | per | default | example | |
|---|---|---|---|---|---|---|---|
"""
ROW = f"""
## Rows of blades

A table `[row]` makes the scene one of N blades in place of the pair: an open chain, or a ring, whose last blade touches
the first. Interface j is between blades j and j + 1; a ring has N of them, a chain one less.

| entry of `[row]` | | default | example |
|---|---|---|---|
| `blades` | number of blades, {MIN_BLADES} to {MAX_BLADES} | | 12 |
| `closed` | whether it is a ring | `false` | `true` |
| `mistuning` | one number, a list, or random with a standard deviation | 0 | `{{sigma = 0.03, seed = 1}}` |
| `sector` | `"auto"`: march a ring [by its sector](row.md#rings-by-their-sector) | `"whole"` | `"auto"` |

What is there per blade is then one number or a list of N, and what is there per interface one number or a list of as
many as there are interfaces: `gap = ["20 um", "25 um", ...]`. A key names one of them by its number from 0:
`blades.k_x[17]`, `shroud.gap[3]`, `row.mistuning[2]`. `gamma` refers to the `k_x` of the blade on the left of its
interface, without mistuning. Mistuning that was drawn is written as a list into results.

`[row.coupling]` holds the keys `coupling.k_x` to `coupling.c_T` of the first table, springs and dampers
[between neighbours](row.md#the-disk-coupling-of-neighbours), and `[row.aero]` influence coefficients of the
[flow](row.md#flow-influence-coefficients-and-flutter) as pairs, `L1 = [real, imaginary]`. Both may be tables of their
own, `[coupling]` and `[aero]`; keys are `coupling.k_x` or `row.coupling.k_x`.

`drive.engine_order` alone sets the phases, $2 \\pi e i / N$ of blade i; with `drive.speed` it sets the frequency too,
which may as well be given by `omega` or `f`. In a ring it is a whole number, and with a speed it is positive. A `phase`
beside it is an error. A row has the consistent reading and blades at both ends;
[a law of your own](derivatives.md#your-own-law-of-contact) is given in Python.

| key | symbol | unit | range | per | default | example | |
|---|---|---|---|---|---|---|---|
"""
HARMONICS = """
## Several harmonics

Tables `[[drive.harmonic]]` drive blade i by `F sin(n (omega t + phi_i) + psi_i)` each, in the direction `beta`, and by
a moment alike, where phi is `drive.phase` and psi the phase of the harmonic. They stand for `drive.beta`, `F_0` and
`M_0`, which are refused beside them. `order` is n, a whole number up to 99, and no two are alike. An `engine_order` may
stand for it: the greatest common divisor of all is then that of the drive, unless `drive.engine_order` gives a divisor
of them, and n the multiple. Another `drive.engine_order`, by `--set`, `--along` or `jaxshroud.vary`, gives such
harmonics other orders, and one that is no divisor is refused; values that give different orders do not run together, as
in one sweep.

```toml
[drive]
speed = "853 rpm"    # and the engine order 4 of the harmonics: omega
phase = 0            # in a row left out: it follows from the engine order

[[drive.harmonic]]
engine_order = 4     # or order = 1
F = 60
beta = "30 deg"

[[drive.harmonic]]
engine_order = 8     # or order = 2
F = [25, 40]
beta = "30 deg"
phase = ["0 deg", "90 deg"]
```

Keys count them from 0: `drive.harmonic[1].F[3]` is the force of the second harmonic on blade 3. `drive.level`
multiplies all of them, and is what to sweep in the place of `drive.F_0`.

In the place of `F`, `beta`, `M` and `phase` a harmonic may have complex amplitudes Q, of which the imaginary part of
Q exp(i n (omega t + phi_i)) acts: `F_x_re` goes with the sine and `F_x_im` with the cosine, and `F_y_re`, `F_y_im`,
`M_re` and `M_im` alike. Forces along x and y and the moment then each have a phase of their own. What is left out is 0.

A table of the load over one period of omega, as CFD gives it, makes the harmonics by itself:

```toml
[drive]
table = "pressure.csv"   # angle [deg], F_x [N], F_y [N], M [N m]: the angle, and one load or more
harmonics = 3            # of the orders 1 to 3, by least squares
```

The path counts from the folder of the scene file. A last row may close the period with the loads of the first. The mean
of the table becomes the mean load, and `check` says what the harmonics leave out: the RMS of the rest over that of the
table about its mean. Results hold the harmonics.

| key | symbol | unit | range | per | default | example | |
|---|---|---|---|---|---|---|---|
"""
FOOT = """
(from the table in `jaxshroud/scene/keys.py` by `python tests/keys.py`)
"""
OF_HARMONICS = [f"drive.harmonic[1].{name}" for name in (*HARMONIC_KEYS, *COMPLEX_KEYS)]
HARMONIC_ROWS = [ALL_KEYS[name] for name in OF_HARMONICS]


def line(row: Key) -> str:
    """One number."""
    default = {None: "none", ...: ""}.get(row.default, row.default)
    default = "`blades.m`" if row.name == "blades.m_y" else default
    unit, per = row.unit.replace("^2", "²"), "blade" if row.pair else "interface" if row.per_interface else ""
    default = WITHOUT_EFFECT.get(row.name, 0.0 if row.name in OF_HARMONICS and default == "none" else default)
    cells = [f"`{row.name}`", f"${row.symbol}$", unit, row.range.words, per]
    example = str(row.example).replace("'", '"') if isinstance(row.example, list) else row.example
    return f"| {' | '.join([*cells, str(default), str(example), row.about])} |\n"


def page() -> str:
    """The whole page."""
    tables = {HEAD: SCENE_KEYS, MORE: INPUT_KEYS, HARMONICS: HARMONIC_ROWS, ROW: ROW_KEYS.values()}
    return "".join(head + "".join(map(line, rows)) for head, rows in tables.items()) + FOOT


if __name__ == "__main__":
    FILE.write_text(page(), encoding="utf-8")
