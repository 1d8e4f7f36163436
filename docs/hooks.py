"""What the site has beside the pages of docs/, which read in the repository too: hooks of MkDocs.

Notebooks, the changelog and pictures come from where they are kept, and links to these lead there. A line of a page
that says that `jaxshroud sweep --help` lists the options becomes this list, and a line of a list that is a name of
`jaxshroud` becomes its reference, of a result with a table of what it holds.
"""

import io
import posixpath
import re
from contextlib import redirect_stdout, suppress
from importlib import import_module
from pathlib import Path

import nbformat
from mkdocs.structure.files import File, Files
from nbconvert import MarkdownExporter
from traitlets.config import Config

ROOT = Path(__file__).parent.parent
ELSEWHERE = {  # what is kept outside docs/ -> its place in the site
    "tests/benchmarks/results/peers.png": "pictures/peers.png",
    "tests/benchmarks/results/peers_light.png": "pictures/peers_light.png",
    "tests/benchmarks/results/order.png": "pictures/order.png",
    "tests/studies/reading.png": "pictures/reading.png",
    "CHANGELOG.md": "changelog.md",
    "tests/studies/README.md": "studies.md",
    **{f"notebooks/{path.name}": f"notebooks/{path.stem}.md" for path in (ROOT / "notebooks").glob("*.ipynb")},
}
LINK = re.compile(r"\[([^]]+)\]\((?!https?:|#)([^)#\s]+)([^)\s]*)\)")
OUTWARDS = re.compile(r"(?<=\])\(\.\./[^)]+\)")  # from a notebook to the repository
HELP = re.compile(r"^`jaxshroud (\w+) --help` lists them\.$", re.MULTILINE)
LISTED = re.compile(r"^- `(jaxshroud[\w.]+)`$", re.MULTILINE)
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
    for source, place in ELSEWHERE.items():
        path = ROOT / source
        if path.suffix == ".ipynb":
            for name, content in rendered(path).items():
                files.append(File.generated(config, f"notebooks/{name}", content=content))
        else:
            content = LINK.sub(r"\1", path.read_text("utf-8")) if path.suffix == ".md" else path.read_bytes()
            files.append(File.generated(config, place, content=content))
    return files


def rendered(path: Path) -> dict[str, str | bytes]:
    """A notebook as a page, and its pictures, by their names."""
    exporter = MarkdownExporter(config=Config({"NbConvertBase": {"display_data_priority": SHOWN}}))
    told = {"unique_key": path.stem, "output_files_dir": "."}
    body, more = exporter.from_notebook_node(nbformat.read(path, as_version=4), resources=told)
    kept = f"The notebook is `notebooks/{path.name}`; its outputs are those it is kept with.\n"
    pictures = {name.removeprefix("./"): content for name, content in more["outputs"].items()}
    return {f"{path.stem}.md": f"{OUTWARDS.sub('', body)}\n{kept}", **pictures}


def on_page_markdown(markdown: str, page, **_) -> str:
    """Put in what commands say, the reference and what results hold, and lead links to places in the site."""
    folder = posixpath.dirname(page.file.src_uri)

    def lead(found: re.Match[str]) -> str:
        source = posixpath.normpath(posixpath.join("docs", folder, found[2]))
        if source.startswith("docs/"):
            return found[0]
        if source not in ELSEWHERE:
            return found[1]
        return f"[{found[1]}]({posixpath.relpath(ELSEWHERE[source], folder or '.')}{found[3]})"

    markdown = LINK.sub(lead, markdown)
    markdown = HELP.sub(lambda found: f"```text\n{help_of(found[1])}```", markdown)
    return LISTED.sub(lambda found: f"\n::: {found[1]}\n\n{numbers(found[1])}", markdown)


def numbers(name: str) -> str:
    """The numbers of a class of results: dimensions after those of the lanes, unit, what they are; else empty."""
    from jaxshroud.io.variable import MOTION, Attribute, CountsVariable, MotionVariable

    module, _, name = name.rpartition(".")
    variables = getattr(getattr(import_module(module), name), "variables", {})
    rows = ["| number | dimensions | unit | |", "|---|---|---|---|"]
    for key, number in variables.items():
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
    return "\n".join(rows) if len(rows) > 2 else ""


def help_of(command: str) -> str:
    """A command's help."""
    from jaxshroud.cli.commands import parser

    printed = io.StringIO()
    with redirect_stdout(printed), suppress(SystemExit):
        parser().parse_args([command, "--help"])
    return printed.getvalue()
