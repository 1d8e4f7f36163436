"""Garbage is left for later while modules are imported beside the main thread, and while programs are loaded ahead."""

import gc
import sys
import threading

import pytest

from jaxshroud.cache.garbage import no_garbage_collected
from jaxshroud.cache.programs import Prefetch
from jaxshroud.cli.computation import import_in_background


def joined_threads(begin):
    before = set(threading.enumerate())
    begin()
    for thread in set(threading.enumerate()) - before:
        thread.join()


def test_garbage_is_collected_again_once_the_last_of_several_has_ended():
    first, second = no_garbage_collected(), no_garbage_collected()
    assert gc.isenabled()
    first.__enter__()
    second.__enter__()
    first.__exit__(None, None, None)
    assert not gc.isenabled()
    second.__exit__(None, None, None)
    assert gc.isenabled()


def test_who_has_turned_it_off_finds_it_off():
    gc.disable()
    try:
        with no_garbage_collected(), no_garbage_collected():
            pass
        assert not gc.isenabled()
    finally:
        gc.enable()


@pytest.mark.parametrize("ahead", ["modules", "programs"])
def test_threads_beside_the_main_one_leave_it(ahead, tmp_path, monkeypatch):
    (tmp_path / "module_that_looks.py").write_text("import gc\nenabled = gc.isenabled()\n")
    monkeypatch.syspath_prepend(tmp_path)
    if ahead == "modules":
        joined_threads(lambda: import_in_background(["module_that_looks"]))
        enabled = sys.modules.pop("module_that_looks").enabled
    else:
        prefetch = Prefetch(lambda name: gc.isenabled())
        joined_threads(lambda: prefetch.start(["a"]))
        enabled = prefetch.take("a")
    assert not enabled
    assert gc.isenabled()
