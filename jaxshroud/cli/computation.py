"""How a command computes: load its scene, choose a method, call its verb, write and print the result.

Imports go on in a thread of their own, while programs are loaded and scenes are marched, which needs little Python. A
picture that fails is named at the end, after all else is written.
"""

import argparse
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from importlib import import_module
from inspect import signature
from pathlib import Path
from threading import Thread
from typing import Any

import jaxshroud
from jaxshroud.batch.plan import Progress
from jaxshroud.cache.garbage import no_garbage_collected
from jaxshroud.cli.command_table import COMMANDS
from jaxshroud.cli.progress import progress_bar
from jaxshroud.cli.run_options import accuracy_warnings_printed, asked_method, load_scene, print_march
from jaxshroud.cli.terminal import (
    claim_directory,
    draw,
    files_written,
    input_errors_at,
    print_table,
    require_free,
    warn_status,
)
from jaxshroud.io.store import write_json
from jaxshroud.scene.file import SceneFile
from jaxshroud.scene.scene import Scene
from jaxshroud.verbs.arguments import MarchPlan
from jaxshroud.version import __version__

DATASETS = ("xarray", "h5netcdf")
STATISTICS = ("scipy.special",)
PICTURES = ("jaxshroud.plotting.pictures",)
PDF_PICTURES = ("matplotlib.backends.backend_pdf",)


def import_in_background(modules: Sequence[str]) -> None:
    """Import modules, if they exist, meanwhile: an import statement of one of them waits until it has been imported."""
    Thread(target=_import_all, args=(modules,)).start()


def _import_all(modules: Sequence[str]) -> None:
    with suppress(ImportError), no_garbage_collected():
        for name in modules:
            import_module(name)


@dataclass
class VerbCall:
    """A command and the call of its verb."""

    file: SceneFile
    options: argparse.Namespace
    arguments: dict[str, Any]  # of the verb, beyond scene and progress
    start: float = 0.0  # of the command [s], by `time.perf_counter`
    march: MarchPlan | None = None  # how the verb marches, as soon as it says so
    result: Any = None

    @property
    def title(self) -> str:
        """The title of the scene, or its name."""
        return self.file.title or self.file.name

    @property
    def seconds(self) -> float:
        """The time since the start [s]."""
        return round(time.perf_counter() - self.start, 2)

    @property
    def paths(self) -> list[Path]:
        """The files that the command is to write."""
        return output_paths(self.options)


def output_paths(options: argparse.Namespace) -> list[Path]:
    """The files that a command is to write: those of its record in the folder --out, or --out itself."""
    return [options.out / name for name in COMMANDS[options.verb].files] or [options.out]


def with_origin(result: Any, file: SceneFile) -> Any:
    """A result that says which file its scene is from."""
    origin = {"title": file.title, "scene": file.text(), "source": file.name, "version": __version__}
    result.data.attrs |= origin
    return result


def call_verb(call: VerbCall, progress: Progress) -> Any:
    """The result of the verb of the command's name, for the scene of the file."""
    verb = getattr(jaxshroud, call.options.verb)
    return with_origin(verb(call.file.scene, **call.arguments, progress=progress), call.file)


def write_files(completed: VerbCall, summary: dict[str, Any] | None = None) -> None:
    """Write a result: `.nc` the result itself, `.json` its summary, a scene not here, anything else its picture."""
    pictures = []
    for path in (path for path in completed.paths if path.suffix != ".toml"):
        if path.suffix == ".nc":
            completed.result.save(path)
        elif path.suffix == ".json":
            write_json(completed.result.summary() if summary is None else summary, path)
        else:
            pictures.append(path)
    if pictures:
        draw(completed.result.plot, *pictures, dpi=completed.options.dpi)


def print_result(completed: VerbCall, rows: Mapping[str, Any], title: str = "") -> None:
    """Warn of runs that stopped early, and print a table that ends with the files written."""
    warn_status(completed.result.status, completed.result.chatter)
    print_table(title or completed.title, {**rows, "written": files_written()})


def plain_arguments(file: SceneFile, options: argparse.Namespace) -> dict[str, Any]:
    """Arguments of a verb by their names: those of [run] from the scene file, the others from options of that name."""
    known = {**vars(options), "n_periods": file.run.periods, "transient": file.run.transient}
    _, *names = signature(getattr(jaxshroud, options.verb)).parameters
    return {name: known[name] for name in names if name in known}


def _claim_output(options: argparse.Namespace) -> None:
    """Refuse files that exist, unless forced, or that cannot be written."""
    if COMMANDS[options.verb].files:
        claim_directory(options.out, COMMANDS[options.verb].files, options.force)
    else:
        require_free(options.out, options.force)


@dataclass(frozen=True, kw_only=True)
class Computation:
    """What is special of a command that computes; by default nothing is."""

    load: Callable[[argparse.Namespace], SceneFile] = load_scene
    # Arguments of the verb that are not options as they are; wrong options are refused here.
    prepare: Callable[[SceneFile, argparse.Namespace], Mapping[str, Any]] = lambda file, options: {}
    imports: Sequence[str] = (*DATASETS, *STATISTICS)  # in the background, beside what draws pictures
    claim: Callable[[argparse.Namespace], None] = _claim_output
    # What is said before the run, of the scenes (leading axis) that are marched.
    announce: Callable[[VerbCall, Scene, MarchPlan], None] = lambda call, scenes, march: None
    run: Callable[[VerbCall, Progress], Any] = call_verb
    output: Callable[[VerbCall], None]  # writes the result, and prints it in words

    def __call__(self, options: argparse.Namespace) -> None:
        """Run the command."""
        command = COMMANDS[options.verb]
        start = time.perf_counter()
        file = self.load(options)
        arguments = {**plain_arguments(file, options), **self.prepare(file, options)}
        self.claim(options)
        call = VerbCall(file, options, arguments, start)

        def told(scenes: Scene, march: MarchPlan) -> None:
            call.march = march
            print_march(file, options, scenes, march)
            self.announce(call, scenes, march)

        if hasattr(options, "accuracy"):
            arguments["method"] = asked_method(file, options)._replace(told=told)
        formats = {path.suffix for path in call.paths}
        pictures = (*(PICTURES if ".png" in formats else ()), *(PDF_PICTURES if ".pdf" in formats else ()))
        import_in_background((*self.imports, *pictures))
        with accuracy_warnings_printed(), progress_bar(command.unit) as report, input_errors_at(file.name):
            call.result = self.run(call, report)
        self.output(call)
