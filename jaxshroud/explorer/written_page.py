"""The page of a scene as a file: what a tab shows once its first diagram is coarse."""

from bokeh.document import Document

from jaxshroud.batch.plan import Progress
from jaxshroud.explorer.diagram import diagram
from jaxshroud.explorer.exploration import Exploration
from jaxshroud.explorer.jobs import Methods
from jaxshroud.explorer.page import TabPage
from jaxshroud.explorer.saves import static_page
from jaxshroud.verbs.simulate import simulate


def written_page(exploration: Exploration, accuracy: str, report: Progress) -> bytes:
    """The page of a scene, which needs no server: its coarse diagram from rest, and its own motion.

    Args:
        exploration: The scene.
        accuracy: The accuracy of both.
        report: Called with the lane-periods done, and in all.
    """
    document = Document()
    page = TabPage(document, exploration, accuracy, Methods())
    window, method = page.centre.window, page.methods.method(exploration, accuracy)
    coarse = diagram(
        exploration.file, window, window.new_values(0, page.amount.values), "independent", page.amount, method, report
    )
    page.show_level(window, "independent", 0, coarse, coarse)
    page.show_run(exploration, simulate(exploration.file, n_periods=page.amount.motion, method=method))
    page.motion.verdict.text = ""
    page.close()
    return static_page(document, page.heading, dark=False)
