"""The server of the page: on this machine alone, at an address that nobody guesses."""

import logging
import secrets
from collections.abc import Callable, Sequence
from typing import Any

from bokeh.application import Application
from bokeh.application.handlers.function import FunctionHandler
from bokeh.document import Document
from bokeh.server.server import BaseServer
from bokeh.server.tornado import BokehTornado
from tornado.httpserver import HTTPServer
from tornado.ioloop import IOLoop
from tornado.netutil import bind_sockets

from jaxshroud.explorer.engine import Engines
from jaxshroud.explorer.entrance import guard_entrance
from jaxshroud.explorer.exploration import Exploration
from jaxshroud.explorer.jobs import Methods
from jaxshroud.explorer.page import TabPage, heading_of
from jaxshroud.scene.checks import MachineError

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
        self.token, self.pages = secrets.token_urlsafe(TOKEN_BYTES), []
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
