"""The scenes that come with the package; free of NumPy and pydantic, for a fast list of them."""

import re
import tomllib
from pathlib import Path

FIGURE = re.compile(r"fig\d\d[a-d]?")  # a figure of the article with Table 1 as it is printed


def shipped() -> dict[str, str]:
    """The name and the title of every shipped scene."""
    return {name: tomllib.loads(path.read_text("utf-8")).get("title", "") for name, path in shipped_paths().items()}


def aliases() -> dict[str, str]:
    """The aliases of shipped scenes: `fig09_printed` is `fig09`, and so on."""
    return {f"{name}_printed": name for name in shipped_paths() if FIGURE.fullmatch(name)}


def shipped_paths() -> dict[str, Path]:
    """The name and the file of every shipped scene."""
    package = Path(__file__).parent.parent
    inside = package / "configs"  # in a wheel; in a checkout they are beside the package
    folder = inside if inside.is_dir() else package.parent / "configs"
    return {path.stem: path for path in sorted(folder.glob("*.toml"))}
