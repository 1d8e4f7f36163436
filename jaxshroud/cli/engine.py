"""The process that computes for a tab of `explore`: `python -m jaxshroud.cli.engine SCENE`, started by its server."""

import sys
from contextlib import redirect_stderr
from io import StringIO

from jaxshroud.cli.commands import set_up_jax
from jaxshroud.explorer.engine import serve


def serve_scene(scene: str) -> None:
    """Serve a tab about a scene until its server closes standard input."""
    with redirect_stderr(StringIO()):  # what there is to say, the server has said
        set_up_jax()
    from jaxshroud.cache.programs import keep_list, prefetch

    prefetch(f"explore {scene}")
    serve(keep_list)


if __name__ == "__main__":
    serve_scene(sys.argv[1])
