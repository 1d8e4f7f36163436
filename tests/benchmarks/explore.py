"""How soon the page of `explore` answers, measured in the browser: `python tests/benchmarks/explore.py [SCENE]`.

All times are of a warm program, from the release of a slider or the end of a choice to the frame that shows the result:
the motion of 100 periods, a coarse diagram of 200 values x 64 periods in all, and the map; further how soon the command
ends at Ctrl-C while it computes. The results are JSON, with the processors that the command could use.
"""

import json
import os
import signal
import statistics
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent / "explore"))
from browser import Tab, browser, chromium, served

REPEATS = 7


def measured(tab, name, act):
    """The median and the largest time until the columns of a source have changed [s]."""
    taken = []
    for i in range(REPEATS):
        tab.wait_ready()
        time.sleep(0.3)
        taken.append(tab.changes(name, lambda i=i: act(i)))
    return {"median": round(statistics.median(taken), 3), "largest": round(max(taken), 3)}


def main(scene="fig09_best"):
    """Measure, and print JSON."""
    with served(scene) as server, browser(chromium()) as chrome:
        tab = Tab(chrome, server.address)
        tab.wait_ready()
        handle = tab.page.locator(".noUi-handle").first
        press = lambda i: handle.press("ArrowRight" if i % 2 else "ArrowLeft")
        press(0)
        times = {
            "motion of 100 periods after a slider": measured(tab, "history", press),
            "motion of 100 periods after a click": measured(
                tab, "history", lambda i: tab.click_diagram(0.2 + 0.08 * i)
            ),
            "coarse diagram after a slider": measured(tab, "samples0", press),
        }
        press(0)  # so that the command computes
        begin = time.monotonic()
        status = server.end(signal.SIGINT)
        times["end at Ctrl-C"] = round(time.monotonic() - begin, 3)
        load = os.getloadavg()[0]
        report = {
            "scene": scene,
            "cores": len(os.sched_getaffinity(0)),
            "load before": load,
            "status": status,
            "s": times,
        }
        print(json.dumps({**report, "console": tab.errors}, indent=1))


if __name__ == "__main__":
    main(*sys.argv[1:])
