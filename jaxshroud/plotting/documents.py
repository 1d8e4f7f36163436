"""Reports as self-contained files: HTML without scripts, fonts or links, and PDF."""

import base64
import io
from collections.abc import Sequence
from functools import partial
from html import escape
from itertools import islice, zip_longest
from pathlib import Path
from textwrap import wrap
from typing import NamedTuple

from matplotlib.backends.backend_pdf import PdfPages
from matplotlib.figure import Figure

from jaxshroud.io.files import write
from jaxshroud.plotting.style import as_is, markup, typeset, unicode_text
from jaxshroud.scene.checks import InputError

DOTS = 180  # per inch, of pictures
A4 = (8.27, 11.69)  # [inch]
LINES_PER_PAGE, TEXT_COLUMNS = 84, 92  # on a page of text
TABLE_COLUMNS = TEXT_COLUMNS + 30  # of a table, in smaller letters
CSS = """
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
    """A section of a report: a heading, and its contents in the order of the fields."""

    heading: str
    paragraphs: Sequence[str] = ()
    table: Sequence[Sequence[str]] = ()  # rows; the first is the header
    figure: Figure | None = None
    verbatim: str = ""


def save_document(title: str, sections: Sequence[Section], path: Path, dpi: int = DOTS) -> None:
    """Write a report as .html or .pdf, completely or not at all.

    Raises:
        InputError: The suffix is neither.
        WriteError: The path cannot be written.
    """
    writers = {".html": partial(html_document, dpi=dpi), ".pdf": pdf_document}
    if path.suffix not in writers:
        raise InputError(f"{path}: a report is .html or .pdf")
    write(path, writers[path.suffix](title, sections))


def html_document(title: str, sections: Sequence[Section], dpi: int = DOTS) -> bytes:
    """The report as one HTML page that needs no other file, with pictures of `dpi` dots per inch."""
    title_tag = f"<title>{escape(unicode_text(title))}</title>"
    head = f'<meta charset="utf-8"><meta name="viewport" content="width=device-width">{title_tag}'
    body = "\n".join(_section_html(section, dpi) for section in sections)
    page = f'<!doctype html>\n<html lang="en"><head>{head}<style>{CSS}</style></head>\n'
    return f"{page}<body><h1>{markup(title)}</h1>\n{body}\n</body></html>\n".encode()


def _section_html(section: Section, dpi: int) -> str:
    parts = [f"<h2>{markup(section.heading)}</h2>", *(f"<p>{markup(text)}</p>" for text in section.paragraphs)]
    if section.table:
        rows = [_row_html(row, "td" if i else "th") for i, row in enumerate(section.table)]
        parts.append("<table>" + "".join(rows) + "</table>")
    if section.figure is not None:
        png = _png_base64(section.figure, dpi)
        parts.append(f'<p><img alt="{escape(section.heading)}" src="data:image/png;base64,{png}"></p>')
    if section.verbatim:
        parts.append(f"<pre>{escape(section.verbatim)}</pre>")
    return "\n".join(parts)


def _row_html(cells: Sequence[str], tag: str) -> str:
    return "<tr>" + "".join(f"<{tag}>{markup(cell)}</{tag}>" for cell in cells) + "</tr>"


def _png_base64(figure: Figure, dpi: int) -> str:
    content = io.BytesIO()
    figure.savefig(content, format="png", dpi=dpi)
    return base64.b64encode(content.getvalue()).decode()


def pdf_document(title: str, sections: Sequence[Section]) -> bytes:
    """The report as PDF: pages of text with the pictures between them."""
    content = io.BytesIO()
    with PdfPages(content, metadata={"Title": unicode_text(title), "CreationDate": None}) as pages:
        lines = [typeset(as_is(title)), "=" * min(len(title), TEXT_COLUMNS), ""]
        for section in sections:
            lines += [*map(as_is, section_lines(section)), ""]
            if section.figure is not None:
                _print_lines(pages, lines)
                pages.savefig(section.figure)
                lines = []
        _print_lines(pages, lines)
    return content.getvalue()


def section_lines(section: Section) -> list[str]:
    """A section as lines of text."""
    lines = [section.heading, "-" * len(section.heading)]
    lines += [line for text in section.paragraphs for line in wrap(text, TEXT_COLUMNS)]
    if section.table:
        lines += [line[:TABLE_COLUMNS] for line in _table_lines(section.table)]
    return lines + section.verbatim.splitlines()


def _table_lines(table: Sequence[Sequence[str]]) -> list[str]:
    """A table as lines of text; the heads of a wide one are folded at words."""
    head, *rows = table
    widths = [max(map(len, column)) for column in zip(*table, strict=True)]
    heads = [head]
    if sum(widths) + 2 * (len(widths) - 1) > TABLE_COLUMNS:
        widths = [
            max(map(len, [*column, *name.split()])) for name, *column in zip(head, *(rows or [head]), strict=True)
        ]
        folded = [wrap(name, width) or [""] for name, width in zip(head, widths, strict=True)]
        heads = list(zip_longest(*folded, fillvalue=""))
    return ["  ".join(c.ljust(w) for c, w in zip(row, widths, strict=True)).rstrip() for row in [*heads, *rows]]


def _print_lines(pages: PdfPages, lines: Sequence[str]) -> None:
    """Print lines on as many pages as they need."""
    remaining = iter(lines)
    while page_lines := list(islice(remaining, LINES_PER_PAGE)):
        page = Figure(figsize=A4)
        widest = max(map(len, page_lines), default=0)
        size = 8.0 if widest <= TEXT_COLUMNS else 8.0 * TEXT_COLUMNS / widest
        page.text(0.08, 0.95, "\n".join(page_lines), family="monospace", size=size, va="top", linespacing=1.35)
        pages.savefig(page)
