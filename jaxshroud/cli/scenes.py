"""The command `scenes`."""

import argparse

from jaxshroud.scene.shipped import aliases, shipped


def scenes_verb(_: argparse.Namespace) -> None:
    """Names and titles of the shipped scenes, with the other names of some."""
    scenes, others = shipped(), {name: other for other, name in aliases().items()}
    for name, title in scenes.items():
        also = f" (also {others[name]})" if name in others else ""
        print(f"{name:<12} {title}{also}")
