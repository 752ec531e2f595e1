"""A note of what native code reads stays true where several threads read."""

from __future__ import annotations

from pathlib import Path

from scenec.schemas.native import native_reading, read_note


def test_who_ends_first_leaves_the_note_of_the_other():
    first, second = native_reading(Path("/a.exr")), native_reading(Path("/b.exr"))
    with first:
        # As another thread would, that begins before the first ends.
        second.__enter__()
        assert read_note() == "/b.exr"
    assert read_note() == "/b.exr"
    second.__exit__(None, None, None)
    assert read_note() == ""


def test_what_was_being_read_before_is_again():
    with native_reading(Path("/a.usd")):
        with native_reading(Path("/b.exr")):
            assert read_note() == "/b.exr"
        assert read_note() == "/a.usd"
    assert read_note() == ""
