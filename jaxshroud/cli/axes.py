"""The axes of a sweep as the command line asks for them."""

import argparse
from dataclasses import replace

import numpy as np

from jaxshroud.cli.parser import Along
from jaxshroud.cli.terminal import CommandError
from jaxshroud.cli.words import count
from jaxshroud.scene.axes import axis
from jaxshroud.scene.file import Axis, SceneFile
from jaxshroud.scene.limits import MOST_VALUES


def with_axes(file: SceneFile, options: argparse.Namespace) -> SceneFile:
    """The scene file with the axes and the direction asked for."""
    axes = file.axes
    if options.along and options.along[0].key is None:
        axes = (_own_axis(file, options.along[0]),)
    elif options.along:
        axes = tuple(_axis(file, asked.key, asked) for asked in options.along)
    if not axes:
        raise CommandError(f"{file.name}: [sweep] is missing; add it, or give --along KEY --values a,b,c")
    return replace(file, axes=axes, direction=options.direction or file.direction)


def _axis(file: SceneFile, key: str, asked: Along) -> Axis:
    num = asked.num
    if num is not None:
        try:
            num = count(0, MOST_VALUES)(num)
        except argparse.ArgumentTypeError as error:
            raise CommandError(f"--along {key}: --num {error}") from None
    return axis(file, key, asked.values, start=asked.start, stop=asked.stop, num=num)


def _own_axis(file: SceneFile, asked: Along) -> Axis:
    """The scene's own axis with some of what describes it replaced."""
    given = {name: value for name, value in vars(asked).items() if value is not None}
    flags = " and ".join(f"--{name}" for name in given)
    if len(file.axes) != 1:
        raise CommandError(f"{flags} needs an --along KEY before it: {file.name} sweeps {len(file.axes) or 'no'} keys")
    (own,), values = file.axes, file.axes[0].values
    if "values" not in given and len(given) < 3:
        if not np.array_equal(values, np.linspace(values[0], values[-1], values.size)):
            raise CommandError(f"{flags}: [sweep] of {file.name} lists its values; give --start, --stop and --num")
        given = {"start": float(values[0]), "stop": float(values[-1]), "num": str(values.size), **given}
    return _axis(file, own.key, Along(**given))
