"""The numbers of a scene as a page of the documentation.

`python tests/keys.py` writes it anew; a test compares.
"""

from pathlib import Path

from jaxshroud.scene.keys import INPUT_KEYS, SCENE_KEYS, Key

FILE = Path(__file__).parent.parent / "docs" / "keys.md"
HEAD = """# The numbers of a scene

A file gives a number in its table, `[shroud] gap = "0.022 mm"`, in SI units or as a string with a unit; `--set`,
`--along` and `jaxshroud.vary` call it by its key, `shroud.gap`. What is there per blade is one number for alike blades
or a pair `[left, right]`; `blades.m[0]` is the left blade's alone. Exactly one of `contact.k` and `contact.gamma` is
given.

| key | symbol | unit | range | per blade | default | example | |
|---|---|---|---|---|---|---|---|
"""
MORE = """
## Data as engineers have them

A file may give frequencies, damping ratios and speeds instead, from which these numbers are worked out
(formulas: `jaxshroud/scene/derived_inputs.py`), and `I = "block"` for the moment of inertia of the block
itself. Two keys for one quantity are an error. These are keys like all others: `--set`, `--along`, `--over`, `--range`,
`--wrt`, `--tolerance` and `jaxshroud.vary` take them, and `--along K` gives for each value, bit for bit, what
`--set K=value` gives. A scene remembers what it is given by: where `blades.m` changes, a scene that is given by `f_x`
and `zeta_x` keeps these, and `k_x` and `c_x` follow. Numbers that are replaced in Python without `vary` are simply
numbers: the inputs that no longer give them do not count.

A speed needs an engine order. For `drive.omega` of a scene with an engine order, `"1300 rpm"` is an error: name
`drive.speed`.

| key | symbol | unit | range | per blade | default | example | |
|---|---|---|---|---|---|---|---|
"""
FOOT = """
(from the table in `jaxshroud/scene/keys.py` by `python tests/keys.py`)
"""


def line(row: Key) -> str:
    """One number."""
    default = {None: "none", ...: ""}.get(row.default, row.default)
    default = "`blades.m`" if row.name == "blades.m_y" else default
    unit, pair = row.unit.replace("^2", "²"), "yes" if row.pair else ""
    cells = [f"`{row.name}`", f"${row.symbol}$", unit, row.range.words, pair]
    example = str(row.example).replace("'", '"') if isinstance(row.example, list) else row.example
    return f"| {' | '.join([*cells, str(default), str(example), row.about])} |\n"


def page() -> str:
    """The whole page."""
    return HEAD + "".join(map(line, SCENE_KEYS)) + MORE + "".join(map(line, INPUT_KEYS)) + FOOT


if __name__ == "__main__":
    FILE.write_text(page(), encoding="utf-8")
