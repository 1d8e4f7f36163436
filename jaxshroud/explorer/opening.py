"""How the browser is told the address: by a file that only its user can read, as all see a process's arguments."""

import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from html import escape
from pathlib import Path

REDIRECT = """<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><meta name="referrer" content="no-referrer">
<meta http-equiv="refresh" content="0; url={address}"><title>jaxshroud explore</title></head>
<body><a href="{address}">jaxshroud explore</a></body></html>
"""


@contextmanager
def redirecting_file(address: str) -> Iterator[Path]:
    """A file that leads a browser to an address, while the context lasts: 0600, in a folder of its own, 0700.

    Args:
        address: The address, with its token.

    Raises:
        OSError: It cannot be written.
    """
    folder = Path(tempfile.mkdtemp(prefix="jaxshroud-", dir=os.environ.get("XDG_RUNTIME_DIR") or None))
    try:
        path = folder / "explore.html"
        with open(os.open(path, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o600), "w", encoding="utf-8") as file:
            file.write(REDIRECT.format(address=escape(address)))
        yield path
    finally:
        shutil.rmtree(folder, ignore_errors=True)
