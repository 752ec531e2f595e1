"""A real browser for the tests: Chromium, driven by Playwright, headless and without a network."""

from __future__ import annotations

import base64
import io
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

#: Where tools/browser.sh puts one.
FETCHED = Path(__file__).parents[2] / ".venv" / "browser"
_NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")


def find_browser() -> tuple[str, dict[str, str]] | None:
    """The executable and what its environment needs; None where there is none."""
    asked = os.environ.get("SCENEC_BROWSER")
    for name in [asked] if asked else _NAMES:
        found = shutil.which(name)
        if found:
            return found, {}
    if not asked and (FETCHED / "stamp").is_file():
        libraries = [str(FETCHED / "lib"), os.environ.get("LD_LIBRARY_PATH", "")]
        return str(FETCHED / "chromium"), {
            "LD_LIBRARY_PATH": os.pathsep.join(filter(None, libraries)),
            "FONTCONFIG_FILE": str(FETCHED / "fonts.conf"),
        }
    return None


@contextmanager
def open_browser() -> Iterator:
    """A running browser, or the test is skipped with the reason."""
    sync_api = pytest.importorskip("playwright.sync_api")
    found = find_browser()
    if found is None:
        pytest.skip("no Chromium: set SCENEC_BROWSER, or run tools/browser.sh (needs npm)")
    path, environment = found
    with sync_api.sync_playwright() as play:
        browser = play.chromium.launch(
            executable_path=path,
            # WebGL is drawn by the CPU.
            args=[
                "--no-sandbox",
                "--disable-dev-shm-usage",
                "--use-angle=swiftshader",
                "--enable-unsafe-swiftshader",
            ],
            env={**os.environ, **environment},
        )
        try:
            yield browser
        finally:
            browser.close()


@contextmanager
def opened_page(browser, file: Path, width: int = 1200, height: int = 800, **context) -> Iterator:
    """A page of ours that fails the test if it logs an error or asks for anything but itself."""
    made = browser.new_context(viewport={"width": width, "height": height}, offline=True, **context)
    page, errors = made.new_page(), []
    # Ten minutes: a page that gets nowhere, and no machine that is slow.
    page.set_default_timeout(600_000)
    page.on("console", lambda m: m.type in ("error", "warning") and errors.append(m.text))
    page.on("pageerror", lambda error: errors.append(str(error)))
    page.on("request", lambda r: r.url.startswith("http") and errors.append(r.url))
    try:
        page.goto(file.as_uri())
        page.wait_for_selector("body[data-ready]")
        yield page
    finally:
        made.close()
    assert errors == []


def canvas_pixels(page, selector: str) -> NDArray[np.uint8]:
    """What a canvas shows, uint8 [h, w, 3]."""
    address = page.eval_on_selector(selector, "c => c.toDataURL()")
    picture = Image.open(io.BytesIO(base64.b64decode(address.partition(",")[2])))
    return np.asarray(picture.convert("RGB"))
