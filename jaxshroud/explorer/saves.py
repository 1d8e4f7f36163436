"""What a page gives to be kept: files that the browser saves, and the page itself without a server."""

import base64
import threading
from typing import Any, NamedTuple

from bokeh.document import Document
from bokeh.embed import file_html
from bokeh.models import CustomJS
from bokeh.resources import INLINE

from jaxshroud.explorer.styles import LIGHT, NIGHT, empty_source, file_text, page_template
from jaxshroud.io.store import dataset_content
from jaxshroud.plotting.style import figure_content
from jaxshroud.results.base import Result

TYPES = {
    "nc": "application/x-netcdf",
    "png": "image/png",
    "svg": "image/svg+xml",
    "toml": "application/toml",
    "html": "text/html",
}
STATIC_ROOTS = "status", "centre", "right"
OF_A_SERVER = "live"  # the name of what a page without a server does not show
_ONE_PICTURE = threading.Lock()  # matplotlib draws one picture at a time


class SavedFile(NamedTuple):
    """A file for the browser to save."""

    name: str
    content: bytes

    @property
    def columns(self) -> dict[str, list[str]]:
        """What the page is sent."""
        kind = TYPES[self.name.rpartition(".")[2]]
        return {"name": [self.name], "type": [kind], "content": [base64.b64encode(self.content).decode()]}


def result_file(name: str, result: Result) -> SavedFile:
    """A result as a file whose ending says what is saved: the result itself (.nc), or its picture."""
    ending = name.rpartition(".")[2]
    if ending == "nc":
        return SavedFile(name, bytes(dataset_content(result.data)))
    with _ONE_PICTURE:
        return SavedFile(name, figure_content(result.plot(), ending))


def download_source() -> Any:
    """A source whose data, once set to the columns of a file, let the browser save it."""
    source = empty_source(("name", "type", "content"), "download")
    source.js_on_change("data", CustomJS(code=file_text("download.js")))
    return source


def template_variables(heading: str) -> dict[str, Any]:
    """What the template of the page needs."""
    return {"heading": heading, "light_motions": LIGHT.motions, "dark_motions": NIGHT.motions}


def static_page(document: Document, heading: str, dark: bool) -> bytes:
    """The page as it is now, as one file that needs no server and no network."""
    copy = Document.from_json(document.to_json())
    roots = [root for root in copy.roots if root.name in STATIC_ROOTS]
    for root in [root for root in copy.roots if root not in roots]:
        copy.remove_root(root)
    for control in copy.select({"name": OF_A_SERVER}):
        control.update(visible=False)
    html = file_html(
        copy,
        INLINE,
        template=page_template(),
        template_variables={**template_variables(heading), "without_server": True, "dark": dark},
        theme=copy.theme,
        suppress_callback_warning=True,
    )
    return html.encode()
