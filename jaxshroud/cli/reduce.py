"""The command `reduce`: files of finite elements become a table of modes."""

import argparse
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from jaxshroud.cli.terminal import CommandError, require_free
from jaxshroud.io.files import place_of, write

SAID_ALIKE = ("n_modes", "units")
OF_MATRICES = ("zeta", "residuals", "residual_frequency", "contact_stiffness")
VECTORS = ("origin", "x_axis", "y_axis")


def reduce_command(options: argparse.Namespace) -> None:
    """Write the table of the modes of a blade."""
    from jaxshroud.io.finite_element import read_dofs, read_matrix, read_model, read_nodes, read_numbers
    from jaxshroud.verbs.reduce import reduce, reduce_shapes

    require_free(options.out, options.force)
    model = read_model([path for path in (options.stiffness, options.mass, options.damping) if path is not None])
    dofs = model.dofs if options.dofs is None else read_dofs(options.dofs)
    nodes = model.nodes if options.nodes is None else read_nodes(options.nodes)
    if dofs is None:
        raise CommandError(
            "the rows of the matrices have no labels; add --dofs FILE with a line node.direction for each"
        )
    if nodes is None:
        raise CommandError("the nodes have no coordinates; add --nodes FILE with lines node, x, y, z")
    said: dict[str, Any] = {name: getattr(options, name) for name in SAID_ALIKE}
    said |= {name: vector for name in VECTORS if (vector := getattr(options, name)) is not None}
    said |= {"dofs": dofs, "nodes": nodes, "shroud": _labels(options.shroud)}
    if model.shapes is None:
        said |= {name: getattr(options, name) for name in OF_MATRICES}
        if options.at_speed is not None:
            said |= {"K_at_speed": read_matrix(options.at_speed), "speed": options.speed}
        blade = reduce(model.K, model.M, C=model.C, fixed=_labels(options.fixed or ""), **said)
    else:
        shapes = {"zeta": options.zeta, **model.shapes}
        blade = reduce_shapes(**shapes, least_collinearity=options.least_collinearity, **said)
    if options.cyclic is not None:
        rows = read_numbers(options.cyclic)
        blade = blade.in_ring(rows[:, 0], rows[:, 1:], options.blades)
    write(options.out, blade.csv.encode())
    print(blade)
    print(place_of(options.out))


def _labels(text: str) -> Sequence[str]:
    """Labels between commas, or those in the lines of a file @FILE."""
    if text.startswith("@"):
        try:
            text = Path(text[1:]).read_text("utf-8")
        except (OSError, UnicodeDecodeError) as error:
            raise CommandError(f"{text[1:]}: cannot be read as labels ({error})") from None
    return [label for label in re.split(r"[,\s]+", text) if label]
