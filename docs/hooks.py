"""What the documentation is made of beside its pages: hooks of MkDocs.

Notebooks, the changelog and pictures come from where they are kept; `{{ help sweep }}` becomes a command's own help,
`{{ output check table1 }}` what a command prints, `{{ file NAME }}` a file, `{{ numbers SweepResult }}` a table of
what a result holds, and `{{ verbs all }}` a table of the verbs by the questions in the heads of their pages.
"""

import io
import re
import subprocess
import sys
from contextlib import redirect_stdout, suppress
from pathlib import Path

import nbformat
from mkdocs.structure.files import File, Files
from nbconvert import MarkdownExporter
from traitlets.config import Config

ROOT = Path(__file__).parent.parent
COPIED = {  # pictures that are kept elsewhere
    "pictures/peers.png": "tests/benchmarks/results/peers.png",
    "pictures/peers_light.png": "tests/benchmarks/results/peers_light.png",
    "pictures/order.png": "tests/benchmarks/results/order.png",
    "pictures/reading.png": "tests/studies/reading.png",
}
PAGES = {"changelog.md": "CHANGELOG.md", "studies.md": "tests/studies/README.md"}
LINK = re.compile(r"\[([^]]+)\]\((?!https?:)[^)]+\)")  # to a file that the site does not have
OUTWARDS = re.compile(r"(?<=\])\(\.\./[^)]+\)")  # from a notebook to the repository
ASKED = re.compile(r"\{\{ (help|output|file|numbers|verbs) ([^}]+) \}\}")
SHOWN = ["image/png", "text/markdown", "text/plain"]  # of a cell's output the first that there is


VERBS = "What can be asked"  # the part of the site that has a page for each command


def on_config(config):
    """List the page of every command."""
    from jaxshroud.cli.command_table import COMMANDS

    verbs = next(part[VERBS] for part in config["nav"] if VERBS in part)
    verbs += [{name: f"verbs/{name}.md"} for name in COMMANDS]
    return config


def on_files(files: Files, config) -> Files:
    """Add the pages and pictures that are kept elsewhere."""
    for place, source in COPIED.items():
        files.append(File.generated(config, place, content=(ROOT / source).read_bytes()))
    for place, source in PAGES.items():
        files.append(File.generated(config, place, content=LINK.sub(r"\1", (ROOT / source).read_text("utf-8"))))
    for path in sorted((ROOT / "notebooks").glob("*.ipynb")):
        for name, content in rendered(path).items():
            files.append(File.generated(config, f"notebooks/{name}", content=content))
    return files


def rendered(path: Path) -> dict[str, str | bytes]:
    """A notebook as a page, and its pictures, by their names."""
    exporter = MarkdownExporter(config=Config({"NbConvertBase": {"display_data_priority": SHOWN}}))
    told = {"unique_key": path.stem, "output_files_dir": "."}
    body, more = exporter.from_notebook_node(nbformat.read(path, as_version=4), resources=told)
    kept = f"The notebook is `notebooks/{path.name}`; its outputs are those it is kept with.\n"
    pictures = {name.removeprefix("./"): content for name, content in more["outputs"].items()}
    return {f"{path.stem}.md": f"{OUTWARDS.sub('', body)}\n{kept}", **pictures}


def on_page_markdown(markdown: str, **_) -> str:
    """Put in what commands say, and what results hold."""

    def put(found: re.Match[str]) -> str:
        if found[1] == "numbers":
            return numbers(found[2])
        if found[1] == "verbs":
            return verbs_by_question()
        return f"```text\n{said(found[1], found[2]).rstrip()}\n```"

    return ASKED.sub(put, markdown)


def verbs_by_question() -> str:
    """Every question with the verbs that answer it, in the order of the commands."""
    from jaxshroud.cli.command_table import COMMANDS

    verbs: dict[str, list[str]] = {}
    for name in COMMANDS:
        question = re.search(r"^question: (.+)$", (ROOT / "docs" / "verbs" / f"{name}.md").read_text("utf-8"), re.M)
        assert question, f"docs/verbs/{name}.md has no question in its head"
        verbs.setdefault(question[1], []).append(f"[{name}]({name}.md)")
    rows = (f"| {question} | {', '.join(links)} |" for question, links in verbs.items())
    return "\n".join(["| question | verb |", "|---|---|", *rows])


def numbers(name: str) -> str:
    """The numbers of a class of results: dimensions after those of the lanes, unit, what they are."""
    import jaxshroud as js
    from jaxshroud.io.variable import MOTION, Attribute, CountsVariable, MotionVariable

    rows = ["| number | dimensions | unit | |", "|---|---|---|---|"]
    for key, number in getattr(js, name).variables.items():
        dims, about = ", ".join(number.dims), number.attributes
        if isinstance(number, MotionVariable):
            fields = [(f"{key}.{field}", f"{dims}, blade".strip(", "), *MOTION[field]) for field in MOTION]
        elif isinstance(number, CountsVariable):
            fields = [(key, "", "", number.label.strip(": "))]
        elif isinstance(number, Attribute):
            continue
        else:
            fields = [(key, dims, about.get("units", ""), about.get("long_name", ""))]
        rows += [f"| `{field}` | {dims} | {unit} | {words} |" for field, dims, unit, words in fields]
    return "\n".join(rows)


def said(what: str, words: str) -> str:
    """A command's help, what it prints, or a file."""
    if what == "file":
        return (ROOT / words).read_text("utf-8")
    if what == "output":
        command = [sys.executable, "-m", "jaxshroud", *words.split()]
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout
    from jaxshroud.cli.commands import parser

    printed = io.StringIO()
    with redirect_stdout(printed), suppress(SystemExit):
        parser().parse_args([words, "--help"])
    return printed.getvalue()
