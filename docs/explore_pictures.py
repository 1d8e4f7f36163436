"""The pictures of the page of `explore`, in Chromium: `python docs/explore_pictures.py` draws them anew."""

import io
import sys
import time
from pathlib import Path

from PIL import Image

PICTURES = Path(__file__).parent / "pictures"
sys.path.insert(0, str(Path(__file__).parent.parent / "tests" / "explore"))
from browser import Tab, browser, chromium, served  # noqa: E402

SCENE = "fig09_best"
ROW = "row_ring12", "--set", 'parts.motion=["x"]'  # a minute, not many
FIRST = {"ring": "peak", "lanes": "value"}  # columns of sources
FRAMES, FRAME_WIDTH = 36, 700  # of the moving picture


def picture(tab, name, full=False):
    """Write what a tab shows, with few colours."""
    content = tab.page.screenshot(full_page=full)
    image = Image.open(io.BytesIO(content)).convert("RGB")
    image.quantize(256, Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE).save(PICTURES / name, optimize=True)


def verdict(tab):
    """Wait for the verdict."""
    tab.wait("Bokeh.documents[0].get_model_by_name('verdict').text.includes('<b>')")
    time.sleep(0.5)


def moving_picture(tab):
    """A click on the diagram, and the blocks of the motion that it shows."""
    frames = []

    def shoot(count):
        for _ in range(count):
            image = Image.open(io.BytesIO(tab.page.screenshot())).convert("RGB")
            height = round(image.height * FRAME_WIDTH / image.width)
            frames.append(image.resize((FRAME_WIDTH, height), Image.Resampling.LANCZOS))

    for share in (0.15, 0.72):
        shoot(3)
        tab.changes("history", lambda share=share: tab.click_diagram(share))
        tab.page.get_by_role("button", name="move").click()
        shoot(FRAMES // 2 - 3)
        tab.page.get_by_role("button", name="stop").click()
    palette = frames[-1].quantize(96, Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE)
    few = [frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames]
    few[0].save(PICTURES / "explore.gif", save_all=True, append_images=few[1:], duration=120, loop=0, optimize=True)


def main():
    """Draw all pictures."""
    pictures_of_a_pair()
    pictures_of_a_row()


def pictures_of_a_pair():
    """The page, a click, the map, and the page in a narrow window."""
    with served(SCENE) as server, browser(chromium()) as chrome:
        tab = Tab(chrome, server.address, height=900)
        tab.wait_ready()
        tab.changes("history", lambda: tab.click_diagram(0.72))
        verdict(tab)
        picture(tab, "explore.png")
        moving_picture(tab)
        tab.page.get_by_role("button", name="Map", exact=True).click()
        tab.wait("Bokeh.documents[0].get_model_by_name('cells').data.x.length >= 49 ** 2")
        picture(tab, "explore_map.png")
        tab.context.close()
        narrow = Tab(chrome, server.address, width=420, height=900, color_scheme="dark", device_scale_factor=1.5)
        narrow.wait_ready()
        picture(narrow, "explore_narrow.png")
        narrow.context.close()


def pictures_of_a_row():
    """The page of a ring."""
    with served(*ROW) as server, browser(chromium()) as chrome:
        tab = Tab(chrome, server.address, height=900)
        for source in ("ring", "lanes"):
            tab.wait(f"Bokeh.documents[0]?.get_model_by_name('{source}').data.{FIRST[source]}.length > 0")
        tab.wait("Bokeh.documents[0].get_model_by_name('status_text').text.includes('Ready')")
        picture(tab, "explore_row.png")


if __name__ == "__main__":
    main()
