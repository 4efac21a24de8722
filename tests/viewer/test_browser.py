"""The page as a browser draws it."""

from __future__ import annotations

import io
import os
import shutil

import numpy as np
import pytest

from polarmap.viewer.patch import patch_of

pytest.importorskip("viser", reason='viser is not installed; pip install "polarmap[view]"')
playwright = pytest.importorskip("playwright.sync_api", reason="playwright, which drives a browser, is not installed")

BROWSER = os.environ.get("CHROMIUM") or shutil.which("chromium") or shutil.which("google-chrome")
SOFTWARE = ("--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader")
TRIES = 20  # until the scene is drawn, which comes after the panel
SLOW = 180_000  # milliseconds; a browser draws without a graphics card here


@pytest.mark.slow
@pytest.mark.skipif(not BROWSER, reason="no Chromium is installed; CHROMIUM=FILE names one")
def test_a_browser_shows_the_surface_and_the_pictures(room_run, ranges):
    from PIL import Image

    from polarmap.viewer.page import Page

    page = Page(port=18_081)
    for keyframe in room_run[0]:
        page.add(patch_of(keyframe, ranges))
    page._kind.value = "normal"
    page.refresh()
    try:
        with playwright.sync_playwright() as driver:
            browser = driver.chromium.launch(executable_path=BROWSER, args=SOFTWARE)
            tab = browser.new_page(locale="en-US", viewport={"width": 800, "height": 480})
            problems = []
            tab.on("pageerror", lambda problem: problems.append(problem))
            tab.goto(page.address)
            tab.get_by_text(f"frame {room_run[0][-1].index}").wait_for(timeout=SLOW)
            for _ in range(TRIES):
                picture = np.array(Image.open(io.BytesIO(tab.screenshot(timeout=SLOW))).convert("RGB")).astype(int)
                scene = picture[120:, :440]
                coloured = np.ptp(scene, axis=-1) > 40  # normals are; the background, the grid and the panel are not
                if coloured.mean() > 0.05:
                    break
            browser.close()
    finally:
        page.close()
    assert not problems
    assert coloured.mean() > 0.05
