"""The page in a real browser: it is loaded, slid, clicked, zoomed, kept, misused, and its program is killed."""

import asyncio
import contextlib
import http.client
import os
import re
import shlex
import signal
import time
import urllib.error
import urllib.parse
import urllib.request
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import psutil
import pytest
import tornado.httpclient
import tornado.websocket
from browser import SMALL, Server, Tab, browser, chromium, served
from numpy.testing import assert_array_equal

import jaxshroud as js
from jaxshroud.cli import commands

pytestmark = [
    pytest.mark.full,
    pytest.mark.skipif(chromium() is None, reason="no Chromium on this machine: apt-get install chromium"),
]
COUNTS = "P_d", "ci", "peak"
REST = 300  # until the server has heard of the last click of another test [ms]


@pytest.fixture(scope="module")
def server():
    with served(*SMALL) as running:
        yield running


@pytest.fixture(scope="module")
def chrome():
    with browser(chromium()) as started:
        yield started


@pytest.fixture(scope="module")
def tab(chrome, server):
    opened = Tab(chrome, server.address)
    opened.wait_ready()
    return opened


@pytest.fixture(autouse=True)
def no_complaints(request):
    """A test finds the page at rest, and leaves the console empty."""
    if "tab" in request.fixturenames:
        opened = request.getfixturevalue("tab")
        opened.page.wait_for_timeout(REST)
        opened.wait_ready()
    yield
    if "tab" in request.fixturenames:
        assert request.getfixturevalue("tab").errors == []


def run_copied(tab, name, tmp_path, monkeypatch, result):
    """The result of a command that the page gives, by the command line itself."""
    monkeypatch.chdir(tmp_path)
    words = shlex.split(tab.text(name))
    assert words[0] == "jaxshroud"
    assert commands.main(words[1:]) == 0
    return js.open(result)


@pytest.mark.release
def test_the_diagram_is_the_sweep_of_the_command_that_is_copied(tab, tmp_path, monkeypatch):
    """From rest, bit for bit: also where the page came to its values level by level."""
    sweep = run_copied(tab, "sweep command", tmp_path, monkeypatch, "diagram/sweep.nc")
    lanes = tab.data("lanes")
    assert_array_equal(lanes["value"], sweep.axes["contact.gamma"])
    for name, values in zip(COUNTS, (sweep.P_d, sweep.P_d_ci, sweep.x_peak[:, 0]), strict=True):
        assert_array_equal(np.array(lanes[name], float), values)
    for level, lanes_of_level in enumerate((slice(0, None, 4), slice(2, None, 4), slice(1, None, 2))):
        points = sweep.motion.x[lanes_of_level, :, 0]
        assert_array_equal(np.array(tab.data(f"samples{level}")["x"]), points[np.isfinite(points)])


def test_a_click_shows_the_motion_that_simulate_has(tab, tmp_path, monkeypatch):
    tab.changes("history", lambda: tab.click_diagram(0.3))
    assert "Motion at contact.gamma" in tab.text("motion")
    run = run_copied(tab, "command", tmp_path, monkeypatch, "run.nc")
    history, last = tab.data("history"), 10 * run.steps_per_period + 1
    assert_array_equal(history["x_1"], run.motion.x[-last:, 0])
    assert_array_equal(history["x_2"], run.motion.x[-last:, 1])
    assert np.ptp(history["x_1"]) > 0


def test_the_verdict_follows_with_its_reasons(tab):
    tab.wait("Bokeh.documents[0].get_model_by_name('verdict').text.includes('<b>')")
    assert "period 1" in tab.text("verdict")
    assert "exponent" in tab.text("verdict")


def test_a_slider_changes_motion_and_diagram_by_the_keyboard_too(tab):
    tab.wait_ready()
    before = tab.data("lanes")["P_d"]
    handle = tab.page.locator(".noUi-handle").first
    tab.changes("lanes", lambda: handle.press("ArrowRight"))
    assert "shroud.gap=" in tab.text("command")
    tab.wait_ready()
    assert tab.data("lanes")["P_d"] != before
    tab.changes("lanes", lambda: tab.page.get_by_role("button", name="Reset all").click())
    assert "shroud.gap" not in tab.text("command")


@pytest.mark.release
def test_wrong_input_is_told_beside_its_field_and_the_page_lives_on(tab):
    field = tab.field("friction.mu")
    field.fill("minus two")
    field.press("Enter")
    alert = tab.page.locator(".wrong[role=alert]:visible").first
    alert.wait_for()
    assert "mu" in alert.inner_text()
    field.fill("0.4")
    tab.changes("history", lambda: field.press("Enter"))
    assert "friction.mu=0.4" in tab.text("command")
    assert not tab.page.locator(".wrong[role=alert]:visible").count()


def test_a_zoom_computes_the_window_anew(tab):
    tab.wait_ready()
    whole = tab.data("lanes")["value"]
    tab.changes("lanes", lambda: tab.page.get_by_role("button", name="zoom in").click())
    part = tab.data("lanes")["value"]
    assert max(part) - min(part) == pytest.approx((max(whole) - min(whole)) / 2)
    assert len(part) >= 200
    tab.wait_ready()
    box = tab.box()
    middle = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2

    def drag():
        tab.page.mouse.move(*middle)
        tab.page.mouse.down()
        tab.page.mouse.move(middle[0] - 120, middle[1], steps=4)
        tab.page.mouse.up()

    tab.changes("lanes", drag)
    assert min(tab.data("lanes")["value"]) > min(part)
    tab.wait_ready()
    tab.changes("lanes", lambda: tab.page.get_by_role("button", name="whole").click())
    assert min(tab.data("lanes")["value"]) == min(whole)


def test_another_direction_says_that_it_is_another_run(tab):
    tab.page.get_by_label("each value starts").select_option("forward")
    tab.wait("Bokeh.documents[0].get_model_by_name('note').text.includes('is another run')")
    assert len(tab.data("forward")["x"]) > 0
    assert len(tab.data("samples0")["x"]) == 0
    tab.page.get_by_label("each value starts").select_option("from rest")
    tab.wait("Bokeh.documents[0].get_model_by_name('samples0').data.x.length > 0")


def test_a_click_on_the_map_goes_there(tab):
    tab.page.get_by_role("button", name="Map", exact=True).click()
    tab.wait("Bokeh.documents[0].get_model_by_name('cells').data.x.length > 0")
    box = tab.box(".bk-Figure:visible")
    at = box["x"] + 0.5 * box["width"], box["y"] + 0.4 * box["height"]
    tab.changes("history", lambda: tab.page.mouse.click(*at))
    assert "contact.gamma=" in tab.text("command")
    assert "shroud.gap=" in tab.text("command")
    tab.page.get_by_role("button", name="Diagram", exact=True).click()


@pytest.mark.parametrize(
    ("what", "begins"),
    [
        ("diagram, NetCDF", b"\x89HDF"),
        ("motion, PNG", b"\x89PNG"),
        ("motion, SVG", b"<?xml"),
        ("scene, TOML", b"title"),
        ("this page, HTML", b"<!DOCTYPE html>"),
    ],
)
def test_what_is_shown_is_kept(tab, tmp_path, what, begins, chrome):
    tab.wait("Bokeh.documents[0].get_model_by_name('samples0').data.x.length > 0")
    tab.page.get_by_label("save", exact=True).select_option(what)
    with tab.page.expect_download() as kept:
        tab.page.get_by_role("button", name="Save", exact=True).click()
    path = tmp_path / kept.value.suggested_filename
    kept.value.save_as(path)
    assert path.read_bytes().lstrip().startswith(begins)
    if path.suffix == ".nc":
        assert js.open(path).complete
    elif path.suffix == ".toml":
        assert js.load(path).scene
    elif path.suffix == ".html":
        still = Tab(chrome, path.as_uri())
        still.wait("Bokeh.documents.length > 0 && Bokeh.documents[0].get_model_by_name('samples0').data.x.length > 0")
        requests = still.page.evaluate("performance.getEntriesByType('resource').length")
        assert (requests, still.errors) == (0, [])
        still.context.close()


def test_two_tabs_do_not_disturb_each_other(tab, chrome, server):
    other = Tab(chrome, server.address)
    other.wait_ready(levels=1)
    before = tab.text("command")
    field = other.field("shroud.gap")
    field.fill("30 um")
    other.changes("history", lambda: field.press("Enter"))
    assert "shroud.gap=" in other.text("command")
    assert tab.text("command") == before
    assert other.errors == []
    engines = psutil.Process(server.process.pid).children
    with_both = len(engines())
    other.context.close()
    until = time.monotonic() + 60
    while len(engines()) >= with_both and time.monotonic() < until:
        time.sleep(0.1)
    assert len(engines()) < with_both  # the work of a closed tab ends


@pytest.mark.release
def test_a_closed_tab_ends_its_work_while_it_compiles(chrome):
    """Nothing stops a compiler but the end of its process."""
    with served(*SMALL, "--set", "contact.reading=levers") as server:
        other = Tab(chrome, server.address)
        other.wait_status("choosing")
        (engine,) = psutil.Process(server.process.pid).children()
        other.context.close()
        engine.wait(timeout=60)  # how soon is told by the study of fields
        assert urllib.request.urlopen(server.address).status == 200


@pytest.mark.release
def test_a_narrow_page_has_no_scroll_bar_to_the_side(chrome, server):
    for width in (420, 1400):
        narrow = Tab(chrome, server.address, width=width, color_scheme="dark")
        narrow.wait_ready(levels=1)
        assert narrow.page.evaluate("document.documentElement.scrollWidth") <= width
        assert narrow.page.evaluate("document.documentElement.classList.contains('dark')")
        assert narrow.errors == []
        narrow.context.close()


def test_nobody_enters_without_the_token(server):
    place, _, token = server.address.rpartition("/")
    for path in ("", "/", "/ws", f"/{token[:-1]}", f"/{token[:-1]}/ws"):
        with pytest.raises(urllib.error.HTTPError, match="404"):
            urllib.request.urlopen(f"{place}{path}")
    socket = {"Sec-WebSocket-Key": "x" * 22 + "==", "Sec-WebSocket-Version": "13", "Upgrade": "websocket"}
    answers = []
    for origin in ("http://example.org", place):
        connection = http.client.HTTPConnection(place.removeprefix("http://"), timeout=20)
        connection.request("GET", f"/{token}/ws", headers={**socket, "Connection": "Upgrade", "Origin": origin})
        answers.append(connection.getresponse().status)
        connection.close()
    assert answers == [403, 101]  # another origin, and, as a control, the page's own
    assert place.startswith("http://127.0.0.1:")


MARKUP = '<img src=x onerror="window.ran=1"><script>window.ran=1</script><b>bold</b> & "quoted"'
RAN = "() => window.ran === undefined && document.querySelectorAll('img[src=x], h1 b').length === 0"


@pytest.mark.release
def test_markup_from_outside_is_text_and_never_runs(chrome, tmp_path):
    """In the title, the file's name, what is typed, messages and units: on the page, and on the page that is saved."""
    scene = tmp_path / '<img src=x onerror="window.ran=1">.toml'
    text = js.load("table1", ['parts.motion=["x"]', "blades.c_x=40"]).text()
    scene.write_text(text.replace(text.splitlines()[0], f"title = {MARKUP!r}"))
    with served(str(scene)) as server:
        tab = Tab(chrome, server.address)
        tab.wait_ready(levels=1)
        assert tab.page.locator("h1").inner_text() == MARKUP
        assert tab.page.title().startswith(MARKUP)
        for key, typed in (("friction.mu", MARKUP), ("shroud.gap", f"1 {MARKUP}")):
            field = tab.field(key)
            field.fill(typed)
            field.press("Enter")
            tab.page.locator(".wrong[role=alert]:visible").first.wait_for()
        end = tab.page.get_by_label("from", exact=True)
        end.fill(MARKUP)
        end.press("Enter")
        tab.wait_ready(levels=1)
        assert "onerror" in tab.text("command")  # the name of the file, to be copied
        tab.page.wait_for_timeout(REST)
        assert tab.page.evaluate(RAN)
        tab.page.get_by_label("save", exact=True).select_option("this page, HTML")
        with tab.page.expect_download() as kept:
            tab.page.get_by_role("button", name="Save", exact=True).click()
        kept.value.save_as(tmp_path / "page.html")
        assert tab.errors == []
        still = Tab(chrome, (tmp_path / "page.html").as_uri())
        still.wait("Bokeh.documents.length > 0")
        still.page.wait_for_timeout(REST)
        assert still.page.locator("h1").inner_text() == MARKUP
        assert still.page.evaluate(RAN)
        still.context.close()
        tab.context.close()


@pytest.mark.release
def test_the_browser_is_opened_without_the_token_among_its_arguments(chrome, tmp_path):
    """A browser that only notes what it is told: a file of its user alone, which leads to the page."""
    told, program = tmp_path / "told", tmp_path / "browser"
    program.write_text(f'#!/bin/sh\necho "$@" >> {told}\n')
    program.chmod(0o755)
    server = Server(*SMALL, opens=True, env={**os.environ, "BROWSER": f"{program} %s"})
    while not (told.exists() and told.read_text().endswith("\n")):
        time.sleep(0.05)
    arguments = told.read_text()
    assert server.address.rpartition("/")[2] not in arguments
    path = Path(urllib.parse.unquote(urllib.parse.urlsplit(arguments.strip()).path))
    assert path.stat().st_mode & 0o777 == 0o600
    tab = Tab(chrome, arguments.strip())
    tab.page.wait_for_url(server.address)
    tab.context.close()
    assert server.end(signal.SIGINT) == 130
    assert not path.exists()


def junk(token):
    """What is no message of Bokeh's, and what is one but makes no sense."""
    yield from ("", "junk", "{}", "[" * 5000, b"\xff\x00", "null", '{"msgid": 1}')
    yield from ('{"msgid": "1", "msgtype": "PATCH-DOC"}', "{}", '{"events": [{"kind": "ModelChanged"}]}')
    yield from ('{"msgid": "1", "msgtype": "PULL-DOC-REQ"}', "{}", '{"x": NaN}')


@pytest.mark.release
def test_junk_and_answers_without_a_socket_begin_nothing_and_print_nothing(chrome):
    server = Server(*SMALL)
    process = psutil.Process(server.process.pid)
    page = urllib.request.urlopen(server.address).read().decode()
    began = process.num_threads(), len(process.children(recursive=True))
    for _ in range(60):
        assert len(urllib.request.urlopen(server.address).read()) > 1000
    assert (process.num_threads(), len(process.children(recursive=True))) == began
    for path in ("autoload.js?bokeh-autoload-element=1", "metadata"):
        with pytest.raises(urllib.error.HTTPError, match="404") as refused:
            urllib.request.urlopen(f"{server.address}/{path}")
        refused.value.close()
    token = re.search(r'"token":"([^"]+)"', page)[1]
    socket = f"ws{server.address.removeprefix('http')}/ws"

    async def send(words, messages):
        request = tornado.httpclient.HTTPRequest(socket, headers={"Origin": server.address.rpartition("/")[0]})
        connection = await tornado.websocket.websocket_connect(request, subprotocols=words)
        for message in messages:
            with contextlib.suppress(tornado.websocket.WebSocketClosedError):
                await connection.write_message(message, binary=isinstance(message, bytes))
                await asyncio.sleep(0.02)
        connection.close()
        while await connection.read_message() is not None:  # until it is closed
            pass

    for words in (["bokeh", token], ["bokeh", token[:-3]], ["bokeh", "junk"], ["other", token]):
        with ThreadPoolExecutor(1) as apart:  # from the loop of the browser's driver
            apart.submit(asyncio.run, send(words, junk(token))).result()
    tab = Tab(chrome, server.address)  # the page lives on
    tab.wait_ready(levels=1)
    assert tab.errors == []
    tab.context.close()
    assert server.end(signal.SIGINT) == 130
    assert server.complaints == "interrupted; nothing was written\n"


@pytest.mark.release
def test_a_page_tells_that_its_program_was_killed_and_a_new_one_opens(chrome):
    first = Server(*SMALL)
    tab = Tab(chrome, first.address)
    tab.wait_ready(levels=1)
    first.end()
    tab.page.locator("#lost").wait_for()
    shown = tab.data("samples0")
    assert len(shown["x"]) >= 200  # what was shown stays
    second = Server(*SMALL)
    assert second.address != first.address
    tab.page.goto(second.address)
    tab.wait_ready(levels=1)
    assert tab.data("samples0")["x"] == shown["x"]
    begin = time.monotonic()
    assert second.end(signal.SIGINT) == 130
    assert time.monotonic() - begin < 60  # that it ends soon is measured by tests/benchmarks/explore.py
    tab.context.close()
