"""A browser without a screen, and the command whose page it looks at: for tests, timings and pictures."""

import re
import shutil
import signal
import subprocess
import sys
from contextlib import contextmanager

# Of the system's Chromium: no network but the page.
FLAGS = (
    *("--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run"),
    *("--disable-background-networking", "--disable-component-update", "--disable-sync"),
)
ADDRESS = re.compile(r"http://\S+")
LONGEST = 300_000  # for a program that is compiled on a busy machine [ms]
LEVELS = 3  # of a diagram
SMALL = ("table1", "--set", 'parts.motion=["x"]', "--set", "blades.c_x=40")  # settles soon, and compiles soon


def chromium():
    """Where the system's Chromium is; None if it is nowhere."""
    return next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)


# A test runner in the background may ignore Ctrl-C, which would be inherited.
COMMAND = """import signal, sys
signal.signal(signal.SIGINT, signal.default_int_handler)
from jaxshroud.cli.commands import main
sys.exit(main())"""


class Server:
    """The command `explore`, running."""

    def __init__(self, *words, opens=False, env=None):
        command = [sys.executable, "-c", COMMAND, "explore", *words, *([] if opens else ["--no-browser"])]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=env)
        self.complaints = ""
        line = self.process.stdout.readline()
        found = ADDRESS.search(line)
        assert found, line + self.process.stderr.read()
        self.address = found[0]

    def end(self, how=signal.SIGKILL):
        """End the command, and wait for it."""
        self.process.send_signal(how)
        self.complaints = self.process.communicate(timeout=60)[1]
        return self.process.returncode


@contextmanager
def served(*words):
    """The command `explore` with these words, while the context lasts."""
    server = Server(*words)
    try:
        yield server
    finally:
        if server.process.poll() is None:
            server.end()


@contextmanager
def browser(path):
    """A browser, while the context lasts."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        started = playwright.chromium.launch(executable_path=path, args=list(FLAGS))
        try:
            yield started
        finally:
            started.close()


class Tab:
    """A tab with the page, and what its console complained about."""

    def __init__(self, browser, address, width=1400, height=1000, **options):
        self.context = browser.new_context(viewport={"width": width, "height": height}, **options)
        self.page, self.errors = self.context.new_page(), []
        self.page.on("console", lambda message: self.errors.append(message.text) if message.type == "error" else None)
        self.page.on("pageerror", lambda error: self.errors.append(str(error)))
        self.page.goto(address)

    def data(self, name):
        """The columns of a source, by its name."""
        code = "name => Object.fromEntries(Object.entries(Bokeh.documents[0].get_model_by_name(name).data)"
        return self.page.evaluate(f"{code}.map(([key, column]) => [key, Array.from(column)]))", name)

    def text(self, name):
        """The text of a model, by its name."""
        return self.page.evaluate("name => Bokeh.documents[0].get_model_by_name(name).text", name)

    def wait(self, condition, argument=None, most=LONGEST):
        """Wait until JavaScript says so."""
        self.page.wait_for_function(condition, arg=argument, timeout=most)

    def wait_ready(self, levels=LEVELS):
        """Wait until the motion and so many levels of the diagram are shown."""
        of = "Bokeh.documents.length > 0 && Bokeh.documents[0].get_model_by_name"
        self.wait(f"{of}('history').data.t.length > 0")
        self.wait(f"{of}('lanes').data.value.length >= {199 * 2 ** (levels - 1) + 1}")
        if levels == LEVELS:
            self.wait(f"{of}('status_text').text.includes('Ready')")

    def wait_status(self, word):
        """Wait until the status of the page has a word."""
        of = "Bokeh.documents.length > 0 && Bokeh.documents[0].get_model_by_name('status_text').text"
        self.wait(f"{of}.includes('{word}')")

    def changes(self, name, act):
        """Do something, and wait for what follows; the time until the columns of a source had changed [s]."""
        code = "name => { window.changed = 0; const source = Bokeh.documents[0].get_model_by_name(name);"
        code += " const begin = performance.now(), heard = () => { source.properties.data.change.disconnect(heard);"
        code += " requestAnimationFrame(() => { window.changed = performance.now() - begin; }); };"
        code += " source.properties.data.change.connect(heard); }"
        self.page.evaluate(code, name)
        act()
        self.wait("window.changed > 0")
        self.wait("!Bokeh.documents[0].get_model_by_name('status_text').text.includes('run: motion')")
        return self.page.evaluate("window.changed") / 1000

    def field(self, key):
        """The input of a key."""
        label = key.partition(".")[2]
        return self.page.locator(f"label:has-text('{label},') >> xpath=.. >> input").first

    def box(self, locator=".bk-Figure"):
        """The place in the window of the first of such elements, by default of the diagram."""
        element = self.page.locator(locator).first
        element.scroll_into_view_if_needed()
        return element.bounding_box()

    def click_diagram(self, share):
        """Click on the diagram at a share of its width."""
        box = self.box()
        self.page.mouse.click(box["x"] + 60 + share * (box["width"] - 110), box["y"] + 0.5 * box["height"])
