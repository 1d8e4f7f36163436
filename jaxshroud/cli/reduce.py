"""The command `reduce`: files of finite elements become a table of modes."""

import argparse
import re
from collections.abc import Sequence
from inspect import signature
from pathlib import Path

from jaxshroud.cli.terminal import CommandError, require_free
from jaxshroud.io.files import place_of, write
from jaxshroud.scene.csv_text import read_csv_text

OTHER_FILES = {"dofs": "a line node.direction for each row", "nodes": "lines node, x, y, z"}


def reduce_command(options: argparse.Namespace) -> None:
    """Write the table of the modes of a blade."""
    from jaxshroud.io.finite_element import read_dofs, read_matrix, read_model, read_nodes, read_numbers
    from jaxshroud.verbs.reduce import reduce, reduce_shapes

    require_free(options.out, options.force)
    given = read_model([path for path in (options.stiffness, options.mass, options.damping) if path is not None])
    for name, read in {"dofs": read_dofs, "nodes": read_nodes}.items():
        if (path := getattr(options, name)) is not None:
            given[name] = read(path)
        if name not in given:
            raise CommandError(f"{options.stiffness}: has no `{name}`; add --{name} FILE with {OTHER_FILES[name]}")
    if "phi" in given:
        _require_no_options_of_matrices(options)
    verb = reduce_shapes if "phi" in given else reduce
    said = {
        name: value for name, value in vars(options).items() if value is not None and name in signature(verb).parameters
    }
    said |= {name: _labels(said[name]) for name in ("shroud", "fixed") if name in said}
    if options.at_speed is not None:
        said["K_at_speed"] = read_matrix(options.at_speed, "K")
    blade = verb(**{**said, **given})
    if options.cyclic is not None:
        rows = read_numbers(options.cyclic)
        blade = blade.in_ring(rows[:, 0], rows[:, 1:], options.blades)
    write(options.out, blade.csv.encode())
    print(blade)
    print(place_of(options.out))


def _require_no_options_of_matrices(options: argparse.Namespace) -> None:
    given = {"--fixed": options.fixed, "--at-speed": options.at_speed, "--no-residuals": not options.residuals}
    for option, value in given.items():
        if value:
            raise CommandError(f"{option} is of matrices, but {options.stiffness} has shapes; leave it out")


def _labels(text: str) -> Sequence[str]:
    """Labels between commas, or those in the lines of a file @FILE."""
    if text.startswith("@"):
        text = read_csv_text(Path(text[1:]), "a text file with labels")
    return [label for label in re.split(r"[,\s]+", text) if label]
