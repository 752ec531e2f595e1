"""A real browser for the tests: Chromium, driven by Playwright, headless and without a network."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

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
