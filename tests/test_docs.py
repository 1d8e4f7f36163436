"""The pages of the documentation: their code runs, reduced where it is slow, and the site they make is whole.

A command on a page is run with the words of `SMALLER` after its own; Python on a page is run with scenes of the
smallest model, and with few periods where nothing else is said. Installation is what CI does anyway.
"""

import json
import re
import shlex
import subprocess
import sys
from functools import partial
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

import beam_model
import jax
import pytest

import jaxshroud as js
from jaxshroud.cli import commands as cli
from jaxshroud.cli.command_table import COMMANDS
from jaxshroud.cli.commands import join_negative_values, parser
from jaxshroud.scene.config import load
from jaxshroud.verbs import arguments, stored, trade
from jaxshroud.verbs.tune import tune

ROOT = Path(__file__).parent.parent
DOCS = ROOT / "docs"
PAGES = sorted([*DOCS.rglob("*.md"), ROOT / "README.md"])
BLOCK = re.compile(r"^```(\w+)\n(.*?)^```", re.MULTILINE | re.DOTALL)
SMALL = ["--set", 'parts.motion=["x"]']
SETTLED = [*SMALL, "--set", "blades.c_x=40", "--set", "drive.M_0=0"]
STEPS = ["--steps-per-period", "100"]
SMALLER = {
    "simulate": [*SMALL, "--periods", "2", *STEPS],
    "sweep": [*SMALL, "--periods", "2", "--transient", "1"],
    "explore": SMALL,
    "table": [*SMALL, "--periods", "4", "--transient", "4", *STEPS],
    "power": [*SMALL, "--periods", "4", "--transient", "1", *STEPS],
    "diagnose": [*SETTLED, *STEPS],
    "animate": ["--periods", "1"],
    "orbit": [*SETTLED, *STEPS],
    "lyapunov": [*SETTLED, *STEPS, "--periods", "4", "--transient", "4"],
    "gradient": [*SETTLED, *STEPS],
    "tune": [*SMALL, "--periods", "2", "--transient", "2", *STEPS, "--draws", "2", "--samples", "4", "--motions", "2"],
    "fit": [*SMALL, *STEPS, "--scan", "2", "--starts", "1"],
    "scatter": [*SMALL, "--samples", "4", "--periods", "2", "--transient", "2", *STEPS],
    "report": [*SETTLED, *STEPS, "--periods", "4", "--transient", "16", "--samples", "4", "--starts", "4"],
    "branch": [*SETTLED, *STEPS, "--num", "3", "--start", "2", "--stop", "2.2", "--at", "2.1"],
    "response": [*SETTLED, *STEPS, "--periods", "2", "--transient", "4", "--most-points", "3", "--num", "3"],
    "mistune": [*SMALL, "--n-patterns", "1", "--num", "2", "--periods", "1", "--transient", "0", "--updates", "0"],
    "attractors": [*SETTLED, *STEPS, "--starts", "4"],
    "basins": [*SETTLED, *STEPS, "--num", "3"],
    "trade": [*SMALL, "--set", "parts.friction=none", "--lanes", "8", "--periods", "4", "--transient", "4"],
}
MEASURED = "t [ms],x_left [mm],x_right [mm]\n1,0.01,-0.01\n2,0.04,-0.05\n3,0.09,-0.08\n4,0.12,-0.13\n"
SCAN = ["--scan", "4", "--starts", "1", "--updates", "1", "--map", "2"]


def blocks(path, language):
    """All code of a page in one language."""
    return [code for found, code in BLOCK.findall(path.read_text("utf-8")) if found == language]


def commands(path):
    """The command lines of a page, without those that install, or read a reader's own scene or what came of it."""
    lines = "".join(blocks(path, "sh")).replace("\\\n", " ").splitlines()
    split = [shlex.split(line, comments=True) for line in lines]
    own = {"FILE.toml"} | {line[line.index("--out") + 1] for line in split if "FILE.toml" in line and "--out" in line}
    return [line[1:] for line in split if line and line[0] == "jaxshroud" and not own & set(line[2:3])]


def reduced(line):
    """A command that does the same for less."""
    line = list(line)
    for i, word in enumerate(line[:-1]):
        if word == "--num" and line[0] == "sweep":
            line[i + 1] = "3"
        if word == "--scheduler":
            line[i + 1] = "local:1"
    if line[0] == "explore" and "--out" not in line:  # which serves until Ctrl-C
        line += ["--out", "page.html"]
    smaller = SMALLER.get(line[0], [])
    if "fem_blade" in line:  # whose damping is that of its modes
        smaller = [word.replace("blades.c_x=40", "blades.modes[0].zeta=0.05") for word in smaller]
    return [*line, *smaller, *(SCAN if line[0] == "tune" else []), *forced(line)]


def forced(line):
    """Words that let a command replace what another page's has written."""
    return ["--force"] if "--out" in line and "--resume" not in line else []


SHELL = [path for path in PAGES if commands(path)]
PYTHON = [path for path in PAGES if blocks(path, "python")]
names = lambda paths: [str(path.relative_to(ROOT)) for path in paths]


@pytest.mark.parametrize("path", SHELL, ids=names(SHELL))
def test_commands_of_a_page_are_understood(path):
    for line in commands(path):
        parser().parse_args(join_negative_values(line))


def test_every_verb_has_a_page_that_shows_it():
    for verb in COMMANDS:
        assert [line for line in commands(DOCS / "verbs" / f"{verb}.md") if line[0] == verb], verb


def test_the_list_of_verbs_has_all_commands_and_names_those_without_a_verb_in_python():
    page = (DOCS / "verbs" / "index.md").read_text("utf-8")
    verbs = {}
    for verb in COMMANDS:
        head = re.match(r"---\nquestion: (.+\?)\n---\n", (DOCS / "verbs" / f"{verb}.md").read_text("utf-8"))
        verbs.setdefault(head[1], []).append(f"[{verb}]({verb}.md)")
    assert "\n".join(f"| {question} | {', '.join(links)} |" for question, links in verbs.items()) in page
    (named,) = re.findall(r"command\s+line\s+alone\s+has(.*?), instead", page, re.DOTALL)
    assert set(re.findall(r"`(\w+)`", named)) == {name for name in COMMANDS if not hasattr(js, name)}


def test_the_start_page_has_the_command_that_installs():
    installs = [blocks(path, "sh")[0] for path in (ROOT / "README.md", DOCS / "start.md", DOCS / "index.md")]
    assert "pip install" in installs[0]
    assert installs == installs[:1] * 3


@pytest.fixture
def small(monkeypatch, tmp_path):
    """Scenes of the smallest model, few periods, and a folder to write to, with the table of designs of its page."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "measured.csv").write_text(MEASURED, "utf-8")
    (tmp_path / "designs.csv").write_text(*blocks(DOCS / "verbs" / "table.md", "csv"))
    beam_model.Model().save(tmp_path / "blade.npz")
    (tmp_path / "shapes.csv").write_text(*blocks(DOCS / "verbs" / "reduce.md", "csv"))
    (tmp_path / "nodes.txt").write_text("101,0.02,0.02,0.2\n102,0.02,-0.02,0.2\n")
    monkeypatch.setattr(trade, "SETTINGS", {contact: ways[:2] for contact, ways in trade.SETTINGS.items()})
    monkeypatch.setattr(arguments, "N_PERIODS", 4)
    monkeypatch.setattr(arguments.Asked, "says_nothing", False)  # RK4, whose programs other tests compile too
    monkeypatch.setattr(js, "tune", partial(tune, search=js.SearchOptions(4, 1, 1)), raising=False)
    monkeypatch.setattr(stored, "MIN_PART_LANES", 64)
    settled = ['parts.motion=["x"]', "blades.c_x=40", "drive.M_0=0", "run.periods=4", "run.transient=4"]
    monkeypatch.setattr(js, "load", lambda path, more=(): load(path, [*more, *settled]), raising=False)


# docs/engineer.md has a notebook, which runs.
@pytest.mark.release(
    only=[f"docs/{page}.md" for page in ("engineer", "row", "scale", "start")]
    + [f"docs/verbs/{verb}.md" for verb in ("explore", "report", "response", "tune")]
)
@pytest.mark.full
@pytest.mark.parametrize("path", SHELL, ids=names(SHELL))
def test_commands_of_a_page_run(path, small, capsys):
    for line in commands(path):
        assert cli.main(reduced(line)) == 0, (line, capsys.readouterr().err)


@pytest.mark.release(only=["docs/derivatives.md", "docs/row.md", "docs/verbs/report.md"])
@pytest.mark.full
@pytest.mark.parametrize("path", PYTHON, ids=names(PYTHON))
def test_python_of_a_page_runs(path, small, capsys):
    told = {}
    with jax.numpy_dtype_promotion("standard"):  # as readers have it, and optax assumes
        for code in blocks(path, "python"):
            exec(code, told)


@pytest.mark.parametrize("path", [path for path in PAGES if blocks(path, "toml")], ids=lambda path: path.stem)
def test_scenes_of_a_page_load(path):
    from jaxshroud.scene.config import parse

    for text in blocks(path, "toml"):
        if "[blades]" in text:
            assert parse(text, path.name).scene.drive.omega > 0


def places_of(page):
    """The places of a page that links may name, as GitHub makes them of heads."""
    heads = re.findall(r"^#+ (.+)$", page.read_text("utf-8"), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", head.lower()).strip().replace(" ", "-") for head in heads}


OTHERS = [ROOT / name for name in ("CONTRIBUTING.md", "CHANGELOG.md", "HISTORY.md", "tests/studies/README.md")]


@pytest.mark.parametrize("path", [*PAGES, *OTHERS], ids=lambda path: str(path.relative_to(ROOT)))
def test_a_page_reads_in_the_repository(path):
    text = path.read_text("utf-8")
    assert not re.findall(r"^:::|^!!!|\{\{|\{ \.\w+ \}", text, re.MULTILINE)  # what only MkDocs knows
    for link in re.findall(r"\]\((?!https?:)([^)\s]+)\)", text):
        file, _, place = link.partition("#")
        to = path.parent / file if file else path
        assert to.exists(), link
        assert not place or place in places_of(to), link


def words_of(text):
    """A text without the line breaks and blanks of a table."""
    return " ".join(line for line in text.split("\n") if not line.startswith("compiled programs")).split()


@pytest.mark.parametrize(
    ("page", "command"), [("check", "check table1"), ("explain", "explain table1"), ("scenes", "scenes")]
)
def test_what_a_page_shows_is_what_the_command_prints(page, command, capsys):
    assert cli.main(command.split()) == 0
    shown = [words_of(block) for block in blocks(DOCS / "verbs" / f"{page}.md", "text")]
    assert words_of(capsys.readouterr().out) in shown


@pytest.mark.parametrize(("page", "file"), [("engineer", "configs/engine_order.toml"), ("wheel", "docs/wheel60.toml")])
def test_a_page_shows_a_file_as_it_is(page, file):
    assert (ROOT / file).read_text("utf-8").rstrip() in (DOCS / f"{page}.md").read_text("utf-8")


class Links(HTMLParser):
    """What a page of the site refers to, and the places that it has."""

    def __init__(self):
        super().__init__()
        self.needed, self.linked, self.places = [], [], set()

    def handle_starttag(self, tag, attrs):
        given = dict(attrs)
        self.places |= {given[name] for name in ("id", "name") if given.get(name)}
        if tag == "a" and given.get("href"):
            self.linked.append(given["href"])
        elif tag == "link" and given.get("rel") in ("stylesheet", "icon", "preload", "preconnect"):
            self.needed.append(given["href"])
        elif given.get("src"):
            self.needed.append(given["src"])


def read(path):
    """The links of a page."""
    links = Links()
    links.feed(path.read_text("utf-8"))
    return links


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """The folder of the site, built without a warning."""
    pytest.importorskip("mkdocs", reason="of the group docs")
    folder = tmp_path_factory.mktemp("docs") / "site"
    build = [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "--site-dir", str(folder)]
    done = subprocess.run(build, cwd=ROOT, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stderr
    return folder


@pytest.mark.release
@pytest.mark.full
def test_the_site_can_be_searched_without_a_server(site):
    index = (site / "search" / "search_index.js").read_text("utf-8")  # a script: pages of a folder may not read files
    assert index.startswith("var __index = ")
    found = json.loads(index.removeprefix("var __index = "))["docs"]
    assert any("Floquet multipliers" in page["text"] for page in found)
    assert "iframe-worker/shim.js" in read(site / "index.html").needed
    assert "window.Worker=o" in (site / "iframe-worker" / "shim.js").read_text("utf-8")


@pytest.mark.full
def test_the_site_is_whole(site):
    pages = {path: read(path) for path in site.rglob("*.html") if path.name != "404.html"}
    assert len(pages) > 30
    for path, links in pages.items():
        assert not [place for place in links.needed if urlsplit(place).netloc], path  # nothing from elsewhere
        for link in links.linked + links.needed:
            parts = urlsplit(link)
            if parts.scheme or parts.netloc:
                continue
            to = (path.parent / unquote(parts.path)).resolve() if parts.path else path
            to = to / "index.html" if to.is_dir() else to
            assert to.exists(), (path, link)
            if parts.fragment and to in pages:
                assert unquote(parts.fragment) in pages[to].places, (path, link)
    fonts = re.findall(r"url\(([^)]+)\)", (site / "katex" / "katex.min.css").read_text("utf-8"))
    assert fonts
    assert all((site / "katex" / font).exists() for font in fonts)


def test_every_public_name_has_its_place_in_the_reference():
    pages = "".join(page.read_text("utf-8") for page in DOCS.rglob("*.md"))
    told = set(re.findall(r"^- `jaxshroud\.(\w+)`$", pages, re.MULTILINE))
    assert {name for name in js.__all__ if not name.startswith("_")} <= told
