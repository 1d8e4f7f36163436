"""Words of pictures and pages: plain text set as formulas, and titles that fit what is shown."""

import re
from collections.abc import Collection, Iterable
from html import escape, unescape

from jaxshroud.scene.keys import KEYS, key_parts

GREEK = "alpha|beta|gamma|zeta|theta|phi|omega|tau|mu|sigma"
SYMBOL = re.compile(rf"(?<![\w\\])(?:({GREEK}|[A-Za-z])_({GREEK}|\w{{1,2}})|({GREEK}))(?!\w)")
POWER = re.compile(r"\b([a-z]+)\^(-?\d)\b")
DECIMAL = re.compile(r"(?<![\w.])(\d+(?:\.\d+)?)e([+-]?)0*(\d+)\b")
KEY = re.compile(rf"\b((?:{'|'.join(sorted({key.partition('.')[0] for key in KEYS}))})\.[A-Za-z]\w*(?:\[\d\])?)")
NAMES = {row.parts[1] for row in KEYS.values()}


def typeset(text: str) -> str:
    """Text with its symbols, powers of units and powers of ten as formulas; formulas in it stay as they are."""
    parts = text.split("$")
    for i in range(0, len(parts), 2):
        plain = SYMBOL.sub(lambda of: f"${_formula(*of.groups())}$", parts[i])
        plain = POWER.sub(r"\1$^{\2}$", plain)
        parts[i] = DECIMAL.sub(lambda of: rf"${of[1]} \times 10^{{{of[2].strip('+')}{of[3]}}}$", plain)
    return "$".join(parts)


def markup(text: str) -> str:
    """The same as HTML; keys of a scene are set as what they are typed as."""
    if text.count("$") % 2:  # no formulas
        return escape(text)
    parts = KEY.split(re.sub(r"\b[A-Za-z](?= / \w)", r"$\g<0>$", text))  # every second is a key
    parts[::2] = [_as_html(typeset(escape(part))).replace("+-", "&plusmn;") for part in parts[::2]]
    parts[1::2] = [f"<code>{part}</code>" for part in parts[1::2]]
    return "".join(parts)


def _as_html(text: str) -> str:
    """Text with formulas as HTML."""
    parts = text.split("$")
    for i in range(1, len(parts), 2):
        formula = re.sub(r"_(\w)", r"_{\1}", parts[i].replace(r"\times", "&times;"))
        formula = re.sub(r"(?<![\\&\w])([A-Za-z])(?![A-Za-z\d;])|\\([A-Za-z]+)", _letter, formula)
        parts[i] = re.sub(r"([_^])\{([^{}]*)\}", lambda of: _shifted(*of.groups()), formula)
    return "".join(parts)


def _letter(of: re.Match[str]) -> str:
    return f"<i>{of[1] or f'&{of[2]};'}</i>"


def _shifted(sign: str, text: str) -> str:
    tag = {"_": "sub", "^": "sup"}[sign]
    return f"<{tag}>{text.replace('-', '&minus;')}</{tag}>"


def plain(text: str) -> str:
    """The same as far as characters go: for titles that bear no markup."""
    text = re.sub(rf"(?<!\w)({GREEK})(?![A-Za-z])", lambda of: unescape(f"&{of[1]};"), text)
    return re.sub(r"(?<=\b\w)_(\d)\b", lambda of: chr(ord("₀") + int(of[1])), text)


def wrapped(text: str, width: int) -> str:
    """Text in lines of some `width` characters as they are seen; formulas are not cut."""
    lines, length = [""], 0
    for word in re.findall(r"(?:\$[^$]*\$|[^\s$])+", text):
        size = len(re.sub(r"\\\w+", "a", word).translate({ord(c): None for c in "${}_^"}))
        if length and length + 1 + size > width:
            lines, length = [*lines, ""], 0
        lines[-1] += f" {word}" if length else word
        length += size + (length > 0)
    return "\n".join(lines)


def _formula(base: str | None, below: str | None, alone: str | None) -> str:
    greek = lambda word: rf"\{word}" if re.fullmatch(GREEK, word) else word  # noqa: E731
    return greek(alone) if alone else f"{greek(base or '')}_{{{greek(below or '')}}}"


def between(value: float, low: float, high: float) -> str:
    """A number with the ends of its interval."""
    return f"{value:.3g} ({low:.3g} to {high:.3g})"


def fitting(title: str, keys: Iterable[str]) -> str:
    """The title, or none where it says something else than a picture over these numbers of a scene.

    It does if it gives one of these numbers a value, or names others that the picture is over.
    """
    varied = {key_parts(key)[1] for key in keys if key.partition("[")[0] in KEYS}
    varied |= {{"k": "gamma", "gamma": "k"}.get(name, name) for name in varied}
    head, _, over = title.partition(" over ")
    over, comma, rest = over.partition(",")
    given = [name for name in varied if f"{name} =" in title or (len(name) > 1 and _named([name], head + comma + rest))]
    others = _named([name for name in NAMES if len(name) > 1], over)
    return "" if given or (others and not others & varied) else title


def _named(names: Collection[str], text: str) -> set[str]:
    return {name for name in names if re.search(rf"(?<!\w){re.escape(name)}(?!\w)", text)}
