"""Pictures that commands write beside their results: one that fails is named at the end, after all else is written."""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from jaxshroud.cli.terminal import one_line

if TYPE_CHECKING:
    from matplotlib.figure import Figure

failed_pictures: list[str] = []  # of this command, with the reasons


def draw(figure: Callable[[], "Figure"], *paths: Path, dpi: int) -> None:
    """Write the picture that `figure` draws, with `dpi` dots per inch; a failure is said at the end of the command."""
    from jaxshroud.plotting.style import save_figure

    try:
        save_figure(figure(), *paths, dpi=dpi)
    except Exception as error:
        names = ", ".join(map(str, paths))
        failed_pictures.append(f"{names}: cannot be drawn ({one_line(error) or type(error).__name__})")
