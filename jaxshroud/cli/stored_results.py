"""The commands of stored results, which simulate nothing: `plot`, `convert` and `animate`."""

import argparse
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from jaxshroud.cli.command_table import COMMANDS, SWEEP_KINDS
from jaxshroud.cli.progress import progress_bar
from jaxshroud.cli.terminal import CommandError, require_free
from jaxshroud.io.files import place_of
from jaxshroud.io.store import read, read_json
from jaxshroud.scene.checks import Error, InputError, StoreError

DRAWN_JSON = {"power.json", "tune.json", "trade.json"}
FILES_IN_FOLDERS = (
    *("sweep.nc", *sorted(DRAWN_JSON), "sweep.zarr"),
    *(command.files[0] for command in COMMANDS.values() if command.files and not DRAWN_JSON & {*command.files}),
)
# The entries that only JSON of that kind has.
POWER_ENTRIES, TUNING = {"n", "P_d", "P_d_ci", "final"}, {"over", "points", "scores", "map"}
TRADE, GRADIENT, SUMMARY = {"settings", "horizon"}, {"of", "kind", "level"}, {"runs", "motions"}


def plot_command(options: argparse.Namespace) -> None:
    """Draw a stored result again."""
    source = _result_in(options.source)
    picture = options.out or source.with_suffix(f".{options.format or 'png'}")
    if options.format and picture.suffix[1:].lower() != options.format:
        raise CommandError(f"{picture}: is named otherwise than --format {options.format}; give one of them")
    if options.out is not None:
        require_free(options.out, options.force)
    draw = draw_json if source.suffix == ".json" else draw_dataset
    draw(source, picture, options)
    print(place_of(picture))


def _result_in(source: Path) -> Path:
    """The result of a folder, or the file itself."""
    if not source.is_dir() or source.suffix == ".zarr":
        return source
    for name in reversed(FILES_IN_FOLDERS):  # a branch has its sweep
        if (source / name).exists():
            return source / name
    state = "holds no result of jaxshroud" if any(source.iterdir()) else "is empty"
    raise CommandError(f"{source} {state}; was the run interrupted?")


def _appearance(options: argparse.Namespace) -> dict[str, Any]:
    """The options of a picture that were given."""
    from jaxshroud.plotting.style import Appearance

    return {name: value for name in Appearance._fields if (value := getattr(options, name)) is not None}


def draw_dataset(source: Path, picture: Path, options: argparse.Namespace) -> None:
    """Draw a result of one or more runs, in one of its kinds of pictures."""
    from jaxshroud.results.base import open as opened
    from jaxshroud.results.base import result_from_dataset

    ds = read(source)
    arguments = _appearance(options)
    if options.kind is not None:
        is_sweep = isinstance(ds.attrs.get("axes"), str)
        if "end_turns" not in ds.attrs and not (is_sweep and options.kind in SWEEP_KINDS):
            raise CommandError(f"{source}: is {'a sweep' if is_sweep else 'no stored run'}; --kind is for stored runs")
        arguments["kind"] = options.kind
    if options.over is not None:
        arguments["over"] = opened(options.over)
    result = result_from_dataset(ds, source)
    _save(source, lambda: result.plot(**arguments), picture, options.dpi)


def draw_json(source: Path, picture: Path, options: argparse.Namespace) -> None:
    """Draw a convergence of P_d, a tuning or a trade."""
    from jaxshroud.plotting.pictures import picture as drawn

    for name in ("kind", "over"):
        if getattr(options, name) is not None:
            raise CommandError(f"{source}: --{name} is for what is stored as .nc")
    data: Any = read_json(source)
    keys = set(data) if isinstance(data, dict) else set()
    if keys >= GRADIENT and "number" not in keys:
        raise CommandError(f"{source}: holds derivatives without the numbers' values; run the command again")
    if keys >= SUMMARY:
        raise CommandError(f"{source}: is the summary of a sweep; give its folder or its sweep.nc")
    kinds = (("gradient", GRADIENT), ("power", POWER_ENTRIES), ("tuned", TUNING), ("trade", TRADE))
    kind = next((kind for kind, needed in kinds if keys >= needed), None)
    if kind is None:
        raise StoreError(f"{source}: not a result of jaxshroud; give a power.json, tune.json or trade.json")
    _save(source, lambda: drawn(kind, data, **_appearance(options)), picture, options.dpi)


@contextmanager
def damage_reported(source: Path) -> Iterator[None]:
    """Within, a result is drawn: an unforeseen error means that it is damaged."""
    with warnings.catch_warnings(action="ignore"):  # matplotlib's warnings of a damaged result do not help
        try:
            yield
        except (Error, OSError, MemoryError):
            raise
        except Exception as error:
            reason = f"lacks {error}" if isinstance(error, KeyError) else f"cannot be drawn ({error})"
            raise StoreError(f"{source}: the result {reason}; run the command again") from None


def _save(source: Path, draw: Callable[[], Any], picture: Path, dpi: int) -> None:
    from jaxshroud.plotting.style import save_figure

    with damage_reported(source):
        try:
            figure = draw()
        except InputError as error:  # the result has no such picture
            raise CommandError(f"{source}: {error}") from None
        try:
            save_figure(figure, picture, dpi=dpi)
        except StoreError:
            raise
        except OSError as error:
            reason = f"cannot be written ({error.strerror or error})"
            raise StoreError(f"{picture}: {reason}; choose another --out") from None
        except (ArithmeticError, RuntimeError, TypeError, ValueError) as error:
            raise CommandError(f"{picture}: {error}") from None


def convert_command(options: argparse.Namespace) -> None:
    """Write a stored result for other programs."""
    from jaxshroud.io.convert import constants_of, constants_path, convert, holds_constants

    if options.source.suffix == ".json":
        raise CommandError(f"{options.source}: other programs read it as it is; give a .nc")
    data = read(options.source)
    if "version" not in data.attrs:
        raise StoreError(f"{options.source}: not a result of jaxshroud; give a .nc that it has written")
    written = [options.out]
    if options.out.suffix == ".csv" and constants_of(data, options.rows):
        written.append(beside := constants_path(options.out))
        if beside.exists() and not holds_constants(beside):  # a scene, perhaps: not even --force is meant for it
            raise CommandError(f"{beside}: exists and holds something else; choose another --out")
    for path in written:
        require_free(path, options.force)
    convert(data, options.out, options.rows)
    print(*map(place_of, written), sep="\n")


def animate_command(options: argparse.Namespace) -> None:
    """Write a stored run as a moving picture."""
    from jaxshroud.plotting.animation import save_animation

    require_free(options.out, options.force)
    data = read(options.source)
    if "end_turns" not in data.attrs:
        raise CommandError(f"{options.source}: not a run; give a file written by `jaxshroud simulate`")
    appearance = {name: getattr(options, name) for name in ("periods", "factor", "title", "dpi")}
    with progress_bar("frames") as report, damage_reported(options.source):
        factor = save_animation(data, options.out, **appearance, progress=report)
    print(f"{place_of(options.out)} (motion and gap exaggerated {factor:g}-fold)")
