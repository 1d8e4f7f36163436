"""The command `reduce`: files of finite elements become a table of modes."""

import argparse
import re
from collections.abc import Sequence
from pathlib import Path

from jaxshroud.cli.terminal import CommandError, require_free
from jaxshroud.io.files import place_of, write

SAID_ALIKE = ("n_modes", "units")
SAID_OF_MATRICES = ("zeta", "residuals", "residual_frequency", "contact_stiffness")
OTHER_FILES = {"dofs": "a line node.direction for each row", "nodes": "lines node, x, y, z"}
VECTORS = ("origin", "x_axis", "y_axis")


def reduce_command(options: argparse.Namespace) -> None:
    """Write the table of the modes of a blade."""
    from jaxshroud.io.finite_element import read_dofs, read_matrix, read_model, read_nodes, read_numbers
    from jaxshroud.verbs.reduce import reduce, reduce_shapes

    require_free(options.out, options.force)
    given = read_model([path for path in (options.stiffness, options.mass, options.damping) if path is not None])
    if options.dofs is not None:
        given["dofs"] = read_dofs(options.dofs)
    if options.nodes is not None:
        given["nodes"] = read_nodes(options.nodes)
    for name, what in OTHER_FILES.items():
        if name not in given:
            raise CommandError(f"{options.stiffness}: has no `{name}`; add --{name} FILE with {what}")
    given |= {name: getattr(options, name) for name in SAID_ALIKE} | {"shroud": _labels(options.shroud)}
    given |= {name: vector for name in VECTORS if (vector := getattr(options, name)) is not None}
    if "phi" in given:
        _require_no_options_of_matrices(options)
        given = {"zeta": options.zeta, "least_collinearity": options.least_collinearity, **given}
        blade = reduce_shapes(**given)
    else:
        given |= {name: getattr(options, name) for name in SAID_OF_MATRICES} | {"fixed": _labels(options.fixed or "")}
        if options.at_speed is not None:
            given |= {"K_at_speed": read_matrix(options.at_speed), "speed": options.speed}
        blade = reduce(**given)
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
        try:
            text = Path(text[1:]).read_text("utf-8")
        except (OSError, UnicodeDecodeError) as error:
            raise CommandError(f"{text[1:]}: cannot be read as labels ({error})") from None
    return [label for label in re.split(r"[,\s]+", text) if label]
