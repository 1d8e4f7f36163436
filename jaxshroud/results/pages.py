"""Reports as files of one piece: HTML without scripts, fonts or addresses, and PDF."""

import base64
import io
from collections.abc import Sequence
from html import escape
from itertools import islice
from pathlib import Path
from textwrap import wrap
from typing import NamedTuple

from matplotlib.backends.backend_pdf import PdfPages
from matplotlib.figure import Figure

from jaxshroud.results.files import write
from jaxshroud.results.words import markup, plain, typeset
from jaxshroud.scene.errors import InputError

DOTS = 180  # per inch, of pictures
A4 = (8.27, 11.69)  # [inch]
LINES, COLUMNS = 84, 92  # of a page of text
STYLE = """
body { font: 16px/1.5 system-ui, sans-serif; color: #1a1a1a; max-width: 60rem; margin: 2rem auto; padding: 0 1rem; }
h1 { font-size: 1.6rem; line-height: 1.25; } h2 { font-size: 1.2rem; margin-top: 2.2rem; }
h2 { border-top: 1px solid #bbb; padding-top: 1rem; }
table { border-collapse: collapse; font-size: .88rem; display: block; overflow-x: auto; }
td, th { padding: .2rem .7rem .2rem 0; text-align: left; vertical-align: top; white-space: nowrap; }
th { border-bottom: 1px solid #1a1a1a; } td { font-variant-numeric: tabular-nums; }
img { max-width: 100%; height: auto; } code { font-size: .92em; } sub, sup { line-height: 0; }
pre { background: #f4f4f4; padding: .8rem; overflow-x: auto; font-size: .82rem; }
.word { font-size: 1.3rem; font-weight: 600; } @media print { h2 { break-after: avoid; } table { overflow: visible; } }
"""


class Section(NamedTuple):
    """A heading with what stands below it, in this order."""

    heading: str
    paragraphs: Sequence[str] = ()
    table: Sequence[Sequence[str]] = ()  # rows; the first is its head
    figure: Figure | None = None
    verbatim: str = ""


def save(title: str, sections: Sequence[Section], path: Path) -> None:
    """Write a report, as its suffix says: .html or .pdf; whole or not at all.

    Raises:
        InputError: The suffix is another one.
        WriteError: The place cannot be written.
    """
    forms = {".html": html, ".pdf": pdf}
    if path.suffix not in forms:
        raise InputError(f"{path}: a report is .html or .pdf")
    write(path, forms[path.suffix](title, sections))


def html(title: str, sections: Sequence[Section]) -> bytes:
    """The report as one page that needs nothing else."""
    named = f"<title>{escape(plain(title))}</title>"
    head = f'<meta charset="utf-8"><meta name="viewport" content="width=device-width">{named}'
    body = "\n".join(map(_block, sections))
    page = f'<!doctype html>\n<html lang="en"><head>{head}<style>{STYLE}</style></head>\n'
    return f"{page}<body><h1>{markup(title)}</h1>\n{body}\n</body></html>\n".encode()


def _block(section: Section) -> str:
    parts = [f"<h2>{markup(section.heading)}</h2>", *(f"<p>{markup(text)}</p>" for text in section.paragraphs)]
    if section.table:
        rows = [_row(row, "td" if i else "th") for i, row in enumerate(section.table)]
        parts.append("<table>" + "".join(rows) + "</table>")
    if section.figure is not None:
        parts.append(f'<p><img alt="{escape(section.heading)}" src="data:image/png;base64,{_png(section.figure)}"></p>')
    if section.verbatim:
        parts.append(f"<pre>{escape(section.verbatim)}</pre>")
    return "\n".join(parts)


def _row(cells: Sequence[str], tag: str) -> str:
    return "<tr>" + "".join(f"<{tag}>{markup(cell)}</{tag}>" for cell in cells) + "</tr>"


def _png(figure: Figure) -> str:
    held = io.BytesIO()
    figure.savefig(held, format="png", dpi=DOTS)
    return base64.b64encode(held.getvalue()).decode()


def pdf(title: str, sections: Sequence[Section]) -> bytes:
    """The report as pages of text with the pictures between them."""
    held = io.BytesIO()
    with PdfPages(held, metadata={"Title": plain(title), "CreationDate": None}) as pages:
        lines = [title if "$" in title else typeset(title), "=" * min(len(title), COLUMNS), ""]
        for section in sections:
            lines += [*_text(section), ""]
            if section.figure is not None:
                _print(pages, lines)
                pages.savefig(section.figure)
                lines = []
        _print(pages, lines)
    return held.getvalue()


def _text(section: Section) -> list[str]:
    """A section as lines of text."""
    lines = [section.heading, "-" * len(section.heading)]
    lines += [line for text in section.paragraphs for line in wrap(text, COLUMNS)]
    if section.table:
        wide = [max(map(len, column)) for column in zip(*section.table, strict=True)]
        rows = ["  ".join(c.ljust(w) for c, w in zip(row, wide, strict=True)).rstrip() for row in section.table]
        lines += [row[: COLUMNS + 30] for row in rows]
    return lines + section.verbatim.splitlines()


def _print(pages: PdfPages, lines: Sequence[str]) -> None:
    """Lines on as many pages as they need."""
    rest = iter(lines)
    while held := list(islice(rest, LINES)):
        page = Figure(figsize=A4)
        widest = max(map(len, held), default=0)
        size = 8.0 if widest <= COLUMNS else 8.0 * COLUMNS / widest
        page.text(0.08, 0.95, "\n".join(held), family="monospace", size=size, va="top", linespacing=1.35)
        pages.savefig(page)
