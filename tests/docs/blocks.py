"""Code blocks of a Markdown page, and running them as a reader would.

A comment right above a block says what is to become of it, and no reader sees it:

    <!-- file: NAME -->       the block is written to NAME, whatever its language
    <!-- not run: REASON -->  the block is not run

Other blocks are run if they are ``sh`` or ``python``, in the page's order and in one folder.
"""

from __future__ import annotations

import itertools
import os
import re
import sys
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

from scenec.testing.processes import ran

ROOT = Path(__file__).resolve().parents[2]
_FENCE = re.compile(
    r"^(?P<ticks>`{3,})(?P<language>[^\n`]*)\n(?P<text>.*?)^(?P=ticks)$", re.MULTILINE | re.DOTALL
)
_COMMENT = re.compile(r"<!-- (?P<what>file|not run): (?P<value>[^\n]+) -->\n\Z")


@dataclass(frozen=True)
class Block:
    """A code block.

    Attributes:
        place: Page and line, for messages.
        language: What stands behind the fence.
        text: The code.
        file: What to write it to; "" where it is no file.
        why_not: Why it is not run; "" where it is.
    """

    place: str
    language: str
    text: str
    file: str
    why_not: str


def blocks(page: str, text: str | None = None) -> Iterator[Block]:
    """All code blocks of a page of the repository, or of a part of its text."""
    whole = (ROOT / page).read_text(encoding="utf-8")
    text = whole if text is None else text
    start = whole.index(text)
    for found in _FENCE.finditer(text):
        comment = _COMMENT.search(text, 0, found.start())
        said = {comment["what"]: comment["value"]} if comment else {}
        line = whole.count("\n", 0, start + found.start()) + 1
        yield Block(
            f"{page}:{line}",
            found["language"].strip(),
            found["text"],
            said.get("file", ""),
            said.get("not run", ""),
        )


def sections(page: str) -> dict[str, str]:
    """The parts of a page under its headings of the second level, by heading."""
    text = (ROOT / page).read_text(encoding="utf-8")
    parts = re.split(r"^(?=## )", text, flags=re.M)[1:]
    return {part.partition("\n")[0].removeprefix("## "): part for part in parts}


def run_all(found: Iterable[Block], folder: Path) -> None:
    """Write the files and run the rest, all in one folder; the first that fails is the error.

    Python blocks with nothing else between them are one program, as in a notebook.
    """
    tools = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    commands = {"sh": ["bash", "-euo", "pipefail", "-c"], "python": [sys.executable, "-c"]}
    kept = [one for one in found if one.file or (one.language in commands and not one.why_not)]
    for (language, file), group in itertools.groupby(kept, lambda one: (one.language, one.file)):
        members = list(group)
        text = "\n".join(one.text for one in members)
        if file:
            (folder / file).parent.mkdir(parents=True, exist_ok=True)
            (folder / file).write_text(text, encoding="utf-8")
            continue
        done = ran(*commands[language], text, cwd=folder, env={**os.environ, "PATH": tools})
        assert done.returncode == 0, f"{members[0].place}\n{text}\n{done.stdout}{done.stderr}"
