"""What a browser gets at the address of the page: HTML without a session, which its socket alone begins."""

from typing import Any

from bokeh.embed.bundle import bundle_for_objs_and_resources
from bokeh.embed.elements import html_page_for_render_items
from bokeh.embed.util import RenderItem
from bokeh.server.views.doc_handler import DocHandler
from bokeh.server.views.ws import WSHandler
from bokeh.util.token import generate_jwt_token, generate_session_id

from jaxshroud.explorer.look import page_template, root
from jaxshroud.explorer.saves import template_variables

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
