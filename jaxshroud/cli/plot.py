"""The command `plot`, and how results of any kind are drawn."""

import argparse
import warnings
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import xarray as xr

from jaxshroud.cli.terminal import CommandError, free
from jaxshroud.results.store import read, read_json
from jaxshroud.scene.errors import InputError, StoreError

if TYPE_CHECKING:
    from jaxshroud.results.drawing import Look

DRAWN_BY_THEMSELVES = ("branch", "attractors", "basins", "diagnosis", "scatter")
IN_FOLDERS = (
    "sweep.nc",
    "power.json",
    "tune.json",
    "trade.json",
    "sweep.zarr",
    *(f"{kind}.nc" for kind in DRAWN_BY_THEMSELVES),
)
# What only a result of that kind has.
POWER, TUNING = {"n", "P_d", "P_d_ci", "final"}, {"over", "points", "scores", "map"}
TRADE, GRADIENT, SUMMARY = {"settings", "horizon"}, {"of", "kind", "level"}, {"lanes", "period numbers"}


def plot_verb(options: argparse.Namespace) -> None:
    """Draw a stored result again."""
    source = options.source
    if source.is_dir() and source.suffix != ".zarr":
        found = [p for p in (source / name for name in reversed(IN_FOLDERS)) if p.exists()]  # a branch has its sweep
        if not found:
            kinds = " nor ".join((IN_FOLDERS[0], ", ".join(IN_FOLDERS[1:])))
            raise CommandError(f"{source}: holds neither {kinds}; give a result of jaxshroud")
        source = found[0]
    picture = options.out or source.with_suffix(f".{options.format or 'png'}")
    if options.format and picture.suffix[1:].lower() != options.format:
        raise CommandError(f"{picture}: is named otherwise than --format {options.format}; give one of them")
    look = _look(options)
    if options.out is not None:
        free(options.out, options.force)
    if source.suffix == ".json":
        if options.kind is not None:
            raise CommandError(f"{source}: --kind is for stored runs")
        draw_json(source, read_json(source), picture, look)
    else:
        draw_dataset(source, read(source), picture, options.kind, look)
    print(picture)


def _look(options: argparse.Namespace) -> "Look":
    from jaxshroud.results.drawing import Look

    return Look(**{name: getattr(options, name) for name in Look._fields})


def draw_dataset(
    source: Path, ds: xr.Dataset, picture: Path, kind: str | None = None, look: "Look | None" = None
) -> None:
    """Draw a sweep, or a trajectory in one of its kinds of pictures."""
    from jaxshroud.results import plot, plot_run
    from jaxshroud.results.base import opened
    from jaxshroud.results.drawing import PLAIN

    axes, look = ds.attrs.get("axes"), look or PLAIN
    if kind is not None and "end_turns" not in ds.attrs:
        told = "a sweep" if isinstance(axes, str) else "no stored run"
        raise CommandError(f"{source}: is {told}; --kind is for stored runs")
    if ds.attrs.get("kind") in DRAWN_BY_THEMSELVES:
        draw = lambda ds, look: opened(ds, source).plot(**look._asdict())  # noqa: E731
    elif isinstance(axes, str):
        draw = lambda ds, look: plot.sweep(ds, **look._asdict())  # noqa: E731
    elif "end_turns" in ds.attrs:
        draw = plot_run.trajectory if kind is None else partial(plot_run.picture, kind=kind)
    else:
        raise StoreError(f"{source}: not a result of jaxshroud; give a sweep or a trajectory")
    _save(source, lambda: draw(ds, look=look), picture)


def draw_json(source: Path, data: Any, picture: Path, look: "Look | None" = None) -> None:
    """Draw a convergence of P_d, a tuning or a trade."""
    from jaxshroud.results import plot_design, plot_effects, plot_power
    from jaxshroud.results.drawing import PLAIN

    keys = set(data) if isinstance(data, dict) else set()
    if keys >= GRADIENT and "number" not in keys:
        raise CommandError(f"{source}: holds derivatives without the numbers' values; run the command again")
    if keys >= SUMMARY:
        raise CommandError(f"{source}: is the summary of a sweep; give its folder or its sweep.nc")
    drawn = (
        (GRADIENT, plot_effects.tornado),
        (POWER, plot_power.power_convergence),
        (TUNING, plot_design.tuning),
        (TRADE, plot_design.trade),
    )
    draw = next((draw for kind, draw in drawn if keys >= kind), None)
    if draw is None:
        raise StoreError(f"{source}: not a result of jaxshroud; give a power.json, tune.json or trade.json")
    _save(source, lambda: draw(data, look=look or PLAIN), picture)


def _save(source: Path, draw: Callable[[], Any], picture: Path) -> None:
    from jaxshroud.results import drawing

    with warnings.catch_warnings(action="ignore"):  # what matplotlib thinks of a damaged result is no cure
        try:
            figure = draw()
        except InputError as error:  # what is stored has no such picture
            raise CommandError(f"{source}: {error}") from None
        except Exception as error:  # of any type: it depends on where the result is damaged
            what = f"lacks {error}" if isinstance(error, KeyError) else f"cannot be drawn ({error})"
            raise StoreError(f"{source}: the result {what}; run the command again") from None
        try:
            drawing.save(figure, picture)
        except StoreError:
            raise
        except OSError as error:
            what = f"cannot be written ({error.strerror or error})"
            raise StoreError(f"{picture}: {what}; choose another --out") from None
        except (ArithmeticError, RuntimeError, TypeError, ValueError) as error:
            raise CommandError(f"{picture}: {error}") from None
