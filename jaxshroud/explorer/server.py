"""The server of the page: on this machine alone, at an address that nobody guesses.

A browser gets HTML without a session, which its socket alone begins. It gets the address from a file that only its
user can read, as all see a process's arguments.
"""

import logging
import os
import secrets
import shutil
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from html import escape
from pathlib import Path
from typing import Any

from bokeh.application import Application
from bokeh.application.handlers.function import FunctionHandler
from bokeh.document import Document
from bokeh.embed.bundle import bundle_for_objs_and_resources
from bokeh.embed.elements import html_page_for_render_items
from bokeh.embed.util import RenderItem
from bokeh.server.server import BaseServer
from bokeh.server.tornado import BokehTornado
from bokeh.server.views.doc_handler import DocHandler
from bokeh.server.views.ws import WSHandler
from bokeh.util.token import generate_jwt_token, generate_session_id
from tornado.httpserver import HTTPServer
from tornado.ioloop import IOLoop
from tornado.netutil import bind_sockets

from jaxshroud.explorer.engine import Engines
from jaxshroud.explorer.exploration import Exploration
from jaxshroud.explorer.jobs import Methods
from jaxshroud.explorer.page import TabPage, heading_of
from jaxshroud.explorer.saves import template_variables
from jaxshroud.explorer.styles import page_template, root
from jaxshroud.scene.checks import MachineError

ROOTS = "status", "left", "centre", "right"  # parts of the page: the names and the ids of what documents have


class PageHandler(DocHandler):
    """Answers with the page, whose documents are all alike until their sockets are open."""

    heading = ""

    async def get(self, *args: Any, **kwargs: Any) -> None:
        """The page with a token for a session of its own."""
        app: Any = self.application
        signing = {"secret_key": app.secret_key, "signed": app.sign_sessions}
        session = generate_session_id(**signing)
        token = generate_jwt_token(session, **signing, expiration=app.session_token_expiration)
        parts: list[Any] = [root(name) for name in ROOTS]
        html = html_page_for_render_items(
            bundle_for_objs_and_resources(None, app.resources()),
            {},
            [RenderItem(token=token, roots=parts, use_for_title=True)],
            self.heading,
            template=page_template(),
            template_variables=template_variables(self.heading),
        )
        self.set_header("Content-Type", "text/html")
        self.write(html)


def guard_entrance(application: Any, heading: str) -> None:
    """Let an application answer with the page as above, and at no other address but its socket begin anything."""
    handler = type("HeadedPage", (PageHandler,), {"heading": heading})
    rules = [rule for rule in application.wildcard_router.rules if "application_context" in (rule.target_kwargs or {})]
    for rule in rules:
        if rule.target is DocHandler:
            rule.target = handler
        elif not issubclass(rule.target, WSHandler):
            application.wildcard_router.rules.remove(rule)


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


HOST = "127.0.0.1"
TOKEN_BYTES = 24
SESSION_CHECK, SESSION_LIFE = 200, 800  # of a tab that has gone [ms]
SILENT = logging.CRITICAL + 1


class ExploreServer:
    """A server with the tabs that are open."""

    def __init__(self, exploration: Exploration, accuracy: str, engine: Sequence[str], port: int = 0):
        """A server that does not run yet.

        Args:
            exploration: The scene.
            accuracy: The accuracy from the start.
            engine: The command of the process that computes for a tab, see `engine.serve`.
            port: The port; 0: any that is free.

        Raises:
            MachineError: The port is taken.
        """
        self.token = secrets.token_urlsafe(TOKEN_BYTES)
        self.pages = []
        methods = Methods()

        def open_page(document: Document) -> None:
            page = TabPage(document, exploration, accuracy, methods, self.engines.take)
            self.pages.append(page)
            document.on_session_destroyed(lambda context: self._close(page))

        for name in ("bokeh", "tornado"):  # what a page fails at, it says; what others send is none of the user's
            logging.getLogger(name).setLevel(SILENT)
        self.loop = IOLoop.current()
        try:
            sockets = bind_sockets(port, HOST)
        except OSError as error:
            raise MachineError(
                f"port {port} of {HOST} cannot be had ({error.strerror}); choose another --port"
            ) from None
        self.port = int(sockets[0].getsockname()[1])
        options: dict[str, Any] = {
            **{"use_index": False, "redirect_root": False, "extra_websocket_origins": [f"{HOST}:{self.port}"]},
            **{"sign_sessions": True, "secret_key": secrets.token_bytes(32), "include_cookies": []},
            **{
                "check_unused_sessions_milliseconds": SESSION_CHECK,
                "unused_session_lifetime_milliseconds": SESSION_LIFE,
            },
        }
        self.engines = Engines(engine)
        application = BokehTornado({f"/{self.token}": Application(FunctionHandler(open_page))}, **options)
        guard_entrance(application, heading_of(exploration))
        http = HTTPServer(application)
        http.add_sockets(sockets)
        self.server = BaseServer(self.loop, application, http)

    @property
    def address(self) -> str:
        """The address of the page."""
        return f"http://{HOST}:{self.port}/{self.token}"

    def run(self, ready: Callable[[str], None]) -> None:
        """Serve until Ctrl-C.

        Args:
            ready: Called with the address once the page can be opened.

        Raises:
            KeyboardInterrupt: Ctrl-C, once all work has ended.
        """
        self.server.start()
        self.loop.add_callback(ready, self.address)
        try:
            self.loop.start()
        finally:
            for page in self.pages:
                page.close()
            self.engines.close()

    def _close(self, page: TabPage) -> None:
        page.close()
        self.pages.remove(page)
