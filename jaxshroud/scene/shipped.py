"""The scenes that come with the package."""

import tomllib
from pathlib import Path


def shipped() -> dict[str, str]:
    """Name and title of every shipped scene."""
    return {name: tomllib.loads(path.read_text("utf-8")).get("title", "") for name, path in shipped_paths().items()}


def shipped_paths() -> dict[str, Path]:
    """Name and file of every shipped scene."""
    package = Path(__file__).parent.parent
    inside = package / "configs"  # in a wheel; in a checkout they lie beside the package
    folder = inside if inside.is_dir() else package.parent / "configs"
    return {path.stem: path for path in sorted(folder.glob("*.toml"))}
