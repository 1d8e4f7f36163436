"""What does explore make of what is typed? 200 entries in a browser: python tests/studies/fields.py

Each entry is typed into a field of one of two scenes, the pair and a pair with numbers per blade, and entered. What is
meant is known apart from the package's own reading: numbers in the unit that the field names, in other units, in lists;
numbers out of their range, decimal commas, markup, words, absurd numbers, halves of numbers. An entry

- is *lost* if a number that is meant is not taken, or if nothing is said beside the field where none is;
- is *altered* if the field then shows another number than was meant, or another field has changed;
- is *executed* if markup ran, or became an element of the page;
- *wedges* the page if a right number that is typed next is not taken.

Last a tab is closed at `CLOSED` moments of its work, in which the method is chosen and programs are compiled: how long
the process that computes for it then lasts. `fields.json` has the counts, and every entry with a fault.
"""

import argparse
import contextlib
import json
import math
import random
import sys
import time
from collections import Counter
from pathlib import Path
from typing import Any, NamedTuple

import psutil
from playwright.sync_api import TimeoutError as PlaywrightTimeout

from jaxshroud.version import __version__

sys.path.insert(0, str(Path(__file__).parent.parent / "explore"))
from browser import Tab, browser, chromium, served

ENTRIES, SEED, CLOSED = 200, 40, 5
ANSWER = 5000  # within which a field answers [ms]
AT_LAST = 60_000  # the same where it has to say something, or to take it back, as other programs may be busy
LONGEST_WORK = 5.0  # of a tab that is closed [s]
TAKEN = "number", "unit", "list"  # kinds whose numbers a scene can have
RAN = "() => window.ran !== undefined || document.querySelectorAll('img[src=x], svg[onload]').length > 0"
SMALL = ("--set", 'parts.motion=["x"]', "--set", "blades.c_x=40")
PER_BLADE = ("--set", "drive.beta=[0.5, 0.6]", "--set", "blades.k_x=[1e5, 1.2e5]")
SCENES = {
    "pair": ("table1", *SMALL),
    "per blade": ("table1", *SMALL, *PER_BLADE),
}
# key -> number of the unit that the page names per SI unit, a right number in that unit, and other units of it per SI
FIELDS: dict[str, tuple[float, float, dict[str, float]]] = {
    "shroud.gap": (1e3, 0.03, {"um": 1e6, "mm": 1e3, "m": 1.0}),
    "friction.mu": (1.0, 0.4, {}),
    "contact.gamma": (1.0, 2.0, {}),
    "blades.k_x": (1e-3, 110.0, {"N/mm": 1e-3, "kN/m": 1e-3}),
    "drive.beta": (180 / math.pi, 35.0, {"deg": 180 / math.pi, "rad": 1.0}),
    "drive.F_0": (1.0, 55.0, {"N": 1.0, "kN": 1e-3}),
    "shroud.alpha": (180 / math.pi, 58.0, {"deg": 180 / math.pi}),
}
PER_BLADE_KEYS = "blades.k_x", "drive.beta", "drive.F_0"
MARKUP = (
    '<img src=x onerror="window.ran=1">',
    "<script>window.ran=1</script>",
    "<b>1</b>",
    "1 <svg onload=window.ran=1>",
    "{{ 7*7 }}",
)
ABSURD = ("1e308", "-1e308", "1e400", "1e-320", "9" * 400, "1e30", "nan", "inf", "-inf")
HALVES = (
    *("3,57", "1,5", "0,03", "3,", "1 000", "3 # 4", "[1", "1]", "1;2", "--1", "1e", "0x", "−5", "1..2"),
    *("", " ", "one", "true"),
)


class Entry(NamedTuple):
    """What is typed, and what it means."""

    key: str
    text: str
    meant: float | list[float] | None  # in SI units; None: nothing that a scene could have
    kind: str


def _number(draw: random.Random, key: str) -> Entry:
    per, right, units = FIELDS[key]
    value = float(f"{right * draw.uniform(0.8, 1.2):.{draw.randint(2, 9)}g}")
    if units and draw.random() < 0.4:
        unit = draw.choice(list(units))
        shown = float(f"{value / per * units[unit]:.6g}")
        return Entry(key, f"{shown!r}{draw.choice(['', ' '])}{unit}", shown / units[unit], "unit")
    text = draw.choice([repr(value), f"{value:.6e}", f" {value!r} "])
    return Entry(key, text, float(text) / per, "number")


def _list(draw: random.Random, key: str) -> Entry:
    per, right, _ = FIELDS[key]
    values = [float(f"{right * draw.uniform(0.8, 1.2):.4g}") for _ in range(2)]
    meant = [value / per for value in values] if key in PER_BLADE_KEYS else None
    return Entry(key, f"[{values[0]!r}, {values[1]!r}]", meant, "list")


def _other(draw: random.Random, key: str) -> Entry:
    texts = {"markup": MARKUP, "absurd": ABSURD, "halves": HALVES, "range": ("-5", "-0.001", "1e6")}
    kind = draw.choice(list(texts))
    text = draw.choice(texts[kind])
    meant = None
    if kind in ("absurd", "range"):
        meant = float(text) / FIELDS[key][0]  # which is taken, or refused with a reason
    return Entry(key, text, meant, kind)


def entries(n: int, seed: int) -> list[Entry]:
    """So many entries: a third numbers, a third lists and units, a third what is none."""
    draw, makers = random.Random(seed), (_number, _list, _other, _other)
    return [makers[i % len(makers)](draw, draw.choice(list(FIELDS))) for i in range(n)]


def _shows(shown: str, per: float, meant: Any) -> bool:
    """Whether a field shows the numbers that were meant, but for the rounding of a unit; alike numbers are one."""
    try:
        value = json.loads(shown, parse_int=float)
    except json.JSONDecodeError:  # what was refused stays in the field
        return False
    of_blades = lambda value: value if isinstance(value, list) else [value] * 2
    found, meant = [one / per for one in of_blades(value)], of_blades(meant)
    return all(math.isclose(f, m, rel_tol=1e-15) for f, m in zip(found, meant, strict=True))


def shown(tab: Tab) -> dict[str, str]:
    """What all fields show."""
    code = "names => names.map(name => Bokeh.documents[0].get_model_by_name(`field ${name}`).value)"
    return dict(zip(FIELDS, tab.page.evaluate(code, list(FIELDS)), strict=True))


def typed(tab: Tab, key: str, text: str, meant: float | list[float] | None) -> str:
    """Type a text and enter it: what is said beside the field, once the server has answered."""
    before, said = shown(tab)[key], tab.text(f"message {key}")
    patience = AT_LAST if meant is None else ANSWER
    field = tab.field(key)
    field.fill(text)
    field.press("Enter")
    code = "([key, ...old]) => { const named = name => Bokeh.documents[0].get_model_by_name(`${name} ${key}`);"
    code += " const said = named('message'), value = named('field').value;"
    code += " return (said.visible && said.text !== old[2]) || !old.slice(0, 2).includes(value); }"
    with contextlib.suppress(PlaywrightTimeout):  # what is shown already is no change
        tab.page.wait_for_function(code, arg=[key, text, before, said], timeout=patience)
    since = time.monotonic()
    while meant is not None and tab.text(f"message {key}") and 1e3 * (time.monotonic() - since) < AT_LAST:
        if tab.text(f"message {key}") != said:  # of this text
            break
        time.sleep(0.1)
    return tab.text(f"message {key}")


def faults(tab: Tab, entry: Entry) -> list[str]:
    """What is wrong with what became of an entry."""
    per, right, _ = FIELDS[entry.key]
    before, said = shown(tab), typed(tab, entry.key, entry.text, entry.meant)
    after, found = shown(tab), []
    if said:
        found += ["lost"] if entry.meant is not None and entry.kind in TAKEN else []
    elif entry.meant is None:
        found.append("lost")
    elif not _shows(after[entry.key], per, entry.meant):
        found.append("altered")
    if any(after[key] != before[key] for key in FIELDS if key != entry.key):
        found.append("altered")
    if tab.page.evaluate(RAN):
        found.append("executed")
    said = typed(tab, entry.key, repr(right), right / per)
    if said or not _shows(shown(tab)[entry.key], per, right / per):
        found.append("wedged")
    return found


def tried(n: int, seed: int, chrome: Any) -> tuple[Counter[str], list[dict[str, Any]]]:
    """Entries of each kind, and those with faults."""
    drawn, bad = entries(n, seed), []
    for i, words in enumerate(SCENES.values()):
        with served(*words) as server:
            tab = Tab(chrome, server.address)
            tab.wait_ready(levels=1)
            for entry in drawn[i :: len(SCENES)]:
                if found := faults(tab, entry):
                    bad.append({**entry._asdict(), "faults": found})
            bad += [{"console": error} for error in tab.errors]
            tab.context.close()
    return Counter(entry.kind for entry in drawn), bad


def closed(n: int, seed: int, chrome: Any) -> list[float]:
    """How long the process of a tab lasts that is closed at so many moments [s]."""
    draw, lasted = random.Random(seed), []
    with served("table1", "--set", "contact.reading=levers") as server:
        for _ in range(n):
            tab = Tab(chrome, server.address)
            tab.wait_status("choosing")
            engine = psutil.Process(server.process.pid).children()[-1]
            time.sleep(draw.uniform(0, LONGEST_WORK))
            tab.context.close()
            begin = time.monotonic()
            engine.wait(timeout=60)
            lasted.append(round(time.monotonic() - begin, 2))
    return lasted


def main() -> None:
    """Run the study and write its figures."""
    made = argparse.ArgumentParser()
    for name, default in dict(entries=ENTRIES, seed=SEED, closed=CLOSED).items():
        made.add_argument(f"--{name}", type=int, default=default)
    asked = made.parse_args()
    with browser(chromium()) as chrome:
        kinds, bad = tried(asked.entries, asked.seed, chrome)
        lasted = closed(asked.closed, asked.seed, chrome)
    counts = Counter(fault for entry in bad for fault in entry.get("faults", ["complaints of the console"]))
    figures = {
        "command": f"python tests/studies/fields.py --entries {asked.entries} --seed {asked.seed}",
        "version": __version__,
        "entries": kinds,
        **{fault: counts[fault] for fault in ("lost", "altered", "executed", "wedged", "complaints of the console")},
        "with faults": bad,
        "process of a closed tab [s]": lasted,
    }
    Path(__file__).with_suffix(".json").write_text(json.dumps(figures, indent=1) + "\n")
    print(json.dumps(figures, indent=1))


if __name__ == "__main__":
    main()
