"""A watched page in a real browser, from disk: it loads itself again when it is written anew."""

from __future__ import annotations

from pathlib import Path

import pytest
from browser import open_browser, opened_page

from scenec.datasets.view.page import write_view
from scenec.datasets.view.watching import sign_of, write_sign
from scenec.testing import made_output

pytestmark = pytest.mark.slow


def test_an_open_page_shows_what_is_written_anew(tmp_path: Path):
    def passes(number: int) -> made_output.Passes:
        return made_output.some_passes(number, 24, 16)

    page_file = tmp_path / "view 1.html"
    first = made_output.make_output(tmp_path / "first", passes, samples=1)
    second = made_output.make_output(tmp_path / "second", passes, samples=2)
    write_view(first, page_file, watched="one")
    write_sign(page_file, "one")
    with open_browser() as browser, opened_page(browser, page_file) as page:
        before = page.text_content("#counts")
        write_view(second, page_file, watched="two")
        write_sign(page_file, "two")
        page.wait_for_selector(f"#counts:not(:text-is('{before}'))")
        assert page.text_content("#title") == "second"
        # Nobody watches any more: the page stays as it is, and asks no longer.
        sign_of(page_file).unlink()
        page.wait_for_selector("body[data-ready]")
