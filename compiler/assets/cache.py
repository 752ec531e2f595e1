"""Reads models once for checking, hashing and all batches."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

from scenec.compiler.assets.model import Model, finish_model
from scenec.compiler.assets.parse import parse_model
from scenec.compiler.assets.shells import ParsedModel

#: What is kept of this many files.
_MOST = 64
_parsed: dict[Path, tuple[list[tuple[int, int]], ParsedModel]] = {}


def parsed_model(file: Path) -> ParsedModel:
    """``parse_model``, once as long as the file and those that belong to it stay as they are.

    Raises:
        SceneError: As ``parse_model``.
    """
    if file in _parsed:
        state, parsed = _parsed[file]
        if state == _state(file, parsed):
            return parsed
        del _parsed[file]
    parsed = parse_model(file)
    if len(_parsed) >= _MOST:
        del _parsed[next(iter(_parsed))]
    _parsed[file] = (_state(file, parsed), parsed)
    return parsed


def _state(file: Path, parsed: ParsedModel) -> list[tuple[int, int]]:
    """When a model's files were changed, and how large they are."""
    found = []
    for path in (file, *parsed.companions):
        try:
            stat = path.stat()
        except OSError:
            return []
        found.append((stat.st_mtime_ns, stat.st_size))
    return found


def cached_model(file: Path, unit_m: float | None, up: str | None, part: str | None) -> Model:
    """``read_model``, once for the same arguments and files.

    Raises:
        SceneError: As ``read_model``.
    """
    return _finished(file, parsed_model(file), unit_m, up, part)


@lru_cache(maxsize=_MOST)
def _finished(
    file: Path, parsed: ParsedModel, unit_m: float | None, up: str | None, part: str | None
) -> Model:
    return finish_model(file, parsed, unit_m=unit_m, up=up, part=part)
