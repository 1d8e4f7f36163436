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
from pathlib import Path
from threading import Thread
from typing import Any, NamedTuple

import jaxshroud
from jaxshroud.batch.plan import Progress
from jaxshroud.batch.xla import one_lane
from jaxshroud.cache.garbage import no_garbage_collected
from jaxshroud.cli.command_table import COMMANDS
from jaxshroud.cli.drawing import draw
from jaxshroud.cli.progress import progress_bar
from jaxshroud.cli.run_options import (
    accuracy_warnings_printed,
    load_scene,
    may_be_in_closed_form,
    resolve_march,
    resolved_options,
)
from jaxshroud.cli.terminal import (
    claim_directory,
    files_written,
    input_errors_at,
    print_table,
    require_free,
    warn_status,
)
from jaxshroud.io.store import write_json
from jaxshroud.march.method import FAST, Choices
from jaxshroud.scene.file import SceneFile
from jaxshroud.scene.scene import Scene
from jaxshroud.verbs.plan import Trials
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


class VerbCall(NamedTuple):
    """A command whose verb is about to be called."""

    file: SceneFile
    options: argparse.Namespace
    arguments: Mapping[str, Any]  # of the verb, beyond scene and progress


class CompletedCall(NamedTuple):
    """A command whose verb has returned."""

    file: SceneFile
    options: argparse.Namespace
    arguments: Mapping[str, Any]
    result: Any
    start: float  # of the command [s], by `time.perf_counter`

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


def call_with_accuracy_warnings(call: VerbCall, progress: Progress) -> Any:
    """The same for a verb that warns of runs that miss the accuracy of the options."""
    with accuracy_warnings_printed():
        return call_verb(call, progress)


def write_files(completed: CompletedCall, summary: dict[str, Any] | None = None) -> None:
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


def print_result(completed: CompletedCall, rows: Mapping[str, Any], title: str = "") -> None:
    """Warn of runs that stopped early, and print a table that ends with the files written."""
    warn_status(completed.result.status, completed.result.chatter)
    print_table(title or completed.title, {**rows, "written": files_written()})


@dataclass(frozen=True, kw_only=True)
class Computation:
    """What is special of a command that computes; by default nothing is."""

    # Further overrides of the scene.
    overrides: Callable[[argparse.Namespace], Sequence[str]] = lambda options: ()
    # Arguments of the verb that are not in the command's record; wrong options are refused here.
    prepare: Callable[[SceneFile, argparse.Namespace], Mapping[str, Any]] = lambda file, options: {}
    # The scenes (leading axis) that the method must suit.
    scenes: Callable[[VerbCall], Scene] = lambda call: one_lane(call.file.scene)
    # The method where steps alone are given; None: of a verb without a method.
    usual: Choices | None = FAST
    # How methods are tried for an accuracy.
    trials: Callable[[VerbCall], Trials] = lambda call: {}
    imports: Sequence[str] = (*DATASETS, *STATISTICS)  # in the background, beside what draws pictures
    announce: Callable[[VerbCall], None] = lambda call: None  # what is said before the run
    run: Callable[[VerbCall, Progress], Any] = call_verb
    output: Callable[[CompletedCall], None]  # writes the result, and prints it in words

    def __call__(self, options: argparse.Namespace) -> None:
        """Run the command."""
        command = COMMANDS[options.verb]
        start = time.perf_counter()
        file = load_scene(options, self.overrides(options))
        arguments = {**_plain_arguments(command.arguments, file, options), **self.prepare(file, options)}
        _claim_output(options)
        call = self._with_method(VerbCall(file, options, arguments))
        self.announce(call)
        with progress_bar(command.unit) as report, input_errors_at(file.name):
            result = self.run(call, report)
        self.output(CompletedCall(call.file, call.options, call.arguments, result, start))

    def _with_method(self, call: VerbCall) -> VerbCall:
        if self.usual is None:
            return call
        with input_errors_at(call.file.name):
            scenes = self.scenes(call)
        formats = {path.suffix for path in output_paths(call.options)}
        pictures = (*(PICTURES if ".png" in formats else ()), *(PDF_PICTURES if ".pdf" in formats else ()))
        import_in_background((*self.imports, *pictures))
        resolved = resolved_options(call.file, call.options, self.usual)
        if may_be_in_closed_form(scenes, resolved.asked, call.options):
            return call._replace(arguments={**call.arguments, "method": resolved.asked})
        march = resolve_march(resolved, call.file, scenes, call.options, self.usual, **self.trials(call))
        return call._replace(arguments={**call.arguments, "method": march.again})


def _plain_arguments(names: Sequence[str], file: SceneFile, options: argparse.Namespace) -> dict[str, Any]:
    """Arguments of a verb by their names: those of [run] from the scene file, the others from options of that name."""
    run = {"n_periods": file.run.periods, "transient": file.run.transient}
    return {name: run[name] if name in run else getattr(options, name) for name in names}


def _claim_output(options: argparse.Namespace) -> None:
    """Refuse files that exist, unless forced, or that cannot be written."""
    if COMMANDS[options.verb].files:
        claim_directory(options.out, COMMANDS[options.verb].files, options.force)
    else:
        require_free(options.out, options.force)
