"""The command `scenes`."""

import argparse

from jaxshroud.scene.shipped import shipped


def run(_: argparse.Namespace) -> None:
    """Names and titles of the shipped scenes."""
    for name, title in shipped().items():
        print(f"{name:<12} {title}")
