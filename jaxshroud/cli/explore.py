"""The command explore: the page of a scene, served to this machine or written as a file."""

import argparse
import sys
import webbrowser
from contextlib import ExitStack, suppress
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

from jaxshroud.cli.progress import SilentReport, progress_bar, reported
from jaxshroud.cli.run_options import load_scene
from jaxshroud.cli.terminal import CommandError, input_errors_at, require_free
from jaxshroud.io.files import place_of, write
from jaxshroud.scene.checks import MachineError

if TYPE_CHECKING:
    from jaxshroud.explorer.exploration import Exploration

MISSING = 'the page needs Bokeh, which is not installed; get it by: pip install "jaxshroud[explore]"'


def explore_command(options: argparse.Namespace) -> None:
    """Serve the page of a scene until Ctrl-C, or write it as a file.

    Raises:
        MachineError: Bokeh is not installed, or the port is taken.
        CommandError: The scene or the place of the file is wrong.
    """
    if find_spec("bokeh") is None:
        raise MachineError(MISSING)
    from jaxshroud.explorer.exploration import Exploration

    file = load_scene(options)
    with input_errors_at(file.name):
        exploration = Exploration(file.text(), options.scene, tuple(options.set))
        _ = exploration.file.scene
    if options.out is None:
        _serve(exploration, options)
    else:
        _write_page(exploration, options)


def _serve(exploration: "Exploration", options: argparse.Namespace) -> None:
    from jaxshroud.cache.programs import stop_prefetch
    from jaxshroud.explorer.server import ExploreServer, redirecting_file

    stop_prefetch()  # the engines load programs
    engine = [sys.executable, "-m", "jaxshroud.cli.engine", exploration.name]
    server = ExploreServer(exploration, str(options.accuracy), engine, options.port)
    opened = ExitStack()

    def ready(address: str) -> None:
        print(f"{exploration.name}: {address}\nCtrl-C ends it", flush=True)
        if not options.no_browser:
            with suppress(OSError):  # the address is printed
                webbrowser.open(opened.enter_context(redirecting_file(address)).as_uri())

    with opened, reported(SilentReport("page")):
        server.run(ready)


def _write_page(exploration: "Exploration", options: argparse.Namespace) -> None:
    from jaxshroud.explorer.page import written_page

    path = Path(options.out)
    if path.suffix != ".html":
        raise CommandError(f"{path}: a page needs a name that ends in .html")
    require_free(path, options.force)
    with progress_bar("lane-periods") as report, input_errors_at(exploration.name):
        content = written_page(exploration, str(options.accuracy), report)
    write(path, content)
    print(place_of(path))
