"""Merges a cfg's file, the files that it extends, and settings of the command line.

Everything ends in one document whose places still name the file, or the setting, that each value
came from. What is behind it makes no difference to a stage: only the document's value counts.
"""

from __future__ import annotations

import copy
import json
import os
import re
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path as FilePath
from typing import Any

from scenec.compiler.cfg import json_positions
from scenec.compiler.cfg.document import CfgSyntaxError, Document, has_half_pair
from scenec.compiler.cfg.faults import pointer
from scenec.compiler.cfg.resources import PREFIX, ResourceError, find_file, packaged_reference
from scenec.compiler.kinds import schema
from scenec.compiler.kinds.finding import Finding, Path, Position
from scenec.schemas.errors import CfgError, Fault
from scenec.schemas.files import as_json
from scenec.schemas.manifest import CFG, CFG_FOLDER, MANIFEST, TIMINGS
from scenec.schemas.spelling import closest, nearest, shown

EXTENDS = "extends"
REPLACES = "replaces"
#: Keys that say something of the file they stand in alone.
_OF_THE_FILE = (EXTENDS, REPLACES, "$schema")
_YAML = (".yaml", ".yml")
_SETTING = re.compile(r"[^.\[\]=\s]+(?:\.[^.\[\]=\s]+|\[\d+\])*")
#: What an item of a list can be called by, where no other has the same.
_NAMES = ("name", "type", "material")


type Merge = tuple[Path, frozenset[str], dict[str, Position]]


@dataclass(frozen=True)
class CfgSource:
    """A cfg that was read, and not checked.

    Attributes:
        document: All of it.
        text: The same as JSON: the file's own bytes, where they are that and all.
        is_verbatim: Whether ``text`` is the file's bytes.
        merges: Objects that were put over others: where, by which keys, and the places of those
            that stayed.
    """

    document: Document
    text: bytes
    is_verbatim: bool
    merges: tuple[Merge, ...] = ()


def read(path: FilePath, settings: Sequence[str] = (), text: bytes | None = None) -> CfgSource:
    """Reads a cfg, what it extends, and settings over it.

    Args:
        path: The file, see ``located``: YAML by its suffix, else JSON.
        settings: Each ``path=value``, as in ``terrain.relief[0].amplitude_m=2``.
        text: JSON in place of the file's content; the file need not be there.

    Raises:
        CfgError: One of the files cannot be read, or a setting has no place.
    """
    if text is None:
        data, document = _read_file(path, Position(1, 1, str(path)))
    else:
        data, document = text, _parsed(text, path)
    nulls: list[Path] = []
    merges: list[Merge] = []
    extends = isinstance(document.value, dict) and EXTENDS in document.value
    if isinstance(document.value, dict) and REPLACES in document.value and not extends:
        message = f"expected the key {EXTENDS} beside it, whose objects it replaces"
        raise _fault(document.keys[REPLACES,], (REPLACES,), message)
    if extends:
        document = _extended(path, document, (path.resolve(),), nulls, merges)
        _take_away(document, nulls)
    for setting in settings:
        _set(document, setting)
    if not (extends or settings) and _is_json(data):
        return CfgSource(document, data, True)
    if extends:
        _rebase_files(document, path.parent)
    if isinstance(document.value, dict):
        for key in _OF_THE_FILE:
            document.value.pop(key, None)
    return CfgSource(document, as_json(document.value).encode(), False, tuple(merges))


def _is_json(data: bytes) -> bool:
    try:
        json.loads(data)
    except ValueError:
        return False
    return True


def _fault(position: Position, at: Path, message: str) -> CfgError:
    return CfgError([Fault(position.file, position.line, position.column, pointer(at), message)])


def located(path: FilePath) -> FilePath:
    """The file of a cfg, which may be one that comes with scenec: ``package:configs/NAME``.

    Raises:
        CfgError: There is no such one.
    """
    name = str(path)
    if not name.startswith(PREFIX):
        return path
    return _cfg_file(name, FilePath(), Position(1, 1, name), ())


def folder_of(path: FilePath) -> FilePath:
    """Returns the folder that the files which a cfg names are relative to.

    That is its own; of an output's ``cfg.json``, that of the cfg which was compiled, as long as it
    is there.
    """
    out = path.parent
    if path.name == CFG and (out / MANIFEST).is_file():
        with suppress(OSError, ValueError, KeyError, TypeError, RecursionError):
            known = out / json.loads((out / TIMINGS).read_bytes())[CFG_FOLDER]
            return known if known.is_dir() else out
    return out


def _cfg_file(reference: str, folder: FilePath, position: Position, at: Path) -> FilePath:
    if reference.startswith(PREFIX) and not FilePath(reference).suffix:
        reference += ".json"
    try:
        return find_file(reference, folder)
    except ResourceError as error:
        raise _fault(position, at, str(error)) from error


def _read_file(path: FilePath, named_at: Position, at: Path = ()) -> tuple[bytes, Document]:
    try:
        data = path.read_bytes()
    except OSError as error:
        raise _fault(named_at, at, error.strerror or str(error)) from error
    except ValueError as error:
        # A zero character in the name.
        raise _fault(named_at, at, f"not a file name: {error}") from error
    return data, _parsed(data, path, path.suffix.lower() in _YAML)


def _parsed(data: bytes, path: FilePath, is_yaml: bool = False) -> Document:
    try:
        if is_yaml:
            # Here: it takes a twentieth of a second, and most cfgs are JSON.
            from scenec.compiler.cfg import yaml_positions

            return yaml_positions.parse(data, str(path))
        return json_positions.parse(data, str(path))
    except CfgSyntaxError as error:
        raise _fault(error.position, (), error.message) from error


def _extended(
    path: FilePath,
    document: Document,
    chain: tuple[FilePath, ...],
    nulls: list[Path],
    merges: list[Merge],
) -> Document:
    """A file's document over that of the file which it extends, if it does."""
    reference = document.value.get(EXTENDS) if isinstance(document.value, dict) else None
    if reference is None:
        return document
    at: Path = (EXTENDS,)
    position = document.values[at]
    if not isinstance(reference, str):
        raise _fault(position, at, f"{shown(reference)}: expected a string, the path of a cfg")
    base = _cfg_file(reference, path.parent, position, at)
    if base.resolve() in chain:
        names = [file.name for file in (*chain, base)]
        raise _fault(position, at, f"a cfg cannot extend itself: {' extends '.join(names)}")
    _, below = _read_file(base, position, at)
    below = _extended(base, below, (*chain, base.resolve()), nulls, merges)
    if not isinstance(below.value, dict):
        raise _fault(below.values[()], (), f"{shown(below.value)}: expected an object")
    value = {key: entry for key, entry in below.value.items() if key not in _OF_THE_FILE}
    merged: dict[Path, tuple[Any, Any]] = {}
    anew = frozenset(_replaced(document, value))
    joined = _merged(value, document.value, (), nulls, merged, anew)
    for at, (was, over) in merged.items():
        left = {key: below.values[*at, key] for key in was if key not in over}
        merges.append((at, frozenset(over), left))
    return Document(
        joined,
        {**below.values, **document.values},
        {**below.keys, **document.keys},
        (*below.duplicates, *document.duplicates),
    )


def _replaced(document: Document, base: dict[str, Any]) -> Iterator[Path]:
    """Yields where the file gives an object anew that would be merged with the base's.

    Raises:
        CfgError: That is no list of paths, or one of the files has no object there.
    """
    given = document.value.get(REPLACES, [])
    if not isinstance(given, list):
        raise _fault(
            document.values[REPLACES,],
            (REPLACES,),
            f"{shown(given)}: expected a list of paths, as in objects.rocks",
        )
    for place, name in enumerate(given):
        at = (REPLACES, place)
        if not isinstance(name, str) or not _SETTING.fullmatch(name):
            expected = "expected a path, as in objects.rocks"
            raise _fault(document.values[at], at, f"{shown(name)}: {expected}")
        path = tuple(name.split("."))
        for whose, owner in (("the file it extends", base), ("this file", document.value)):
            for word in path:
                if not (isinstance(owner, dict) and isinstance(owner.get(word), dict)):
                    names = [k for k, v in owner.items() if isinstance(v, dict)]
                    message = f"{whose} has no object {shown(word)} there{nearest(word, names)}"
                    raise _fault(document.values[at], at, f"{shown(name)}: {message}")
                owner = owner[word]
        yield path


def _merged(
    base: dict[str, Any],
    over: dict[str, Any],
    at: Path,
    nulls: list[Path],
    merged: dict[Path, tuple[Any, Any]],
    anew: frozenset[Path],
) -> Any:
    """Objects merge key by key, the base's first; anything else replaces what was there.

    So do objects at the paths ``anew``.
    """
    merged[at] = base, over
    result = dict(base)
    for key, value in over.items():
        was = base.get(key)
        if (*at, key) in anew:
            result[key] = value
            continue
        if isinstance(was, dict) and isinstance(value, dict) and _is_of_kind(value, was):
            result[key] = _merged(was, value, (*at, key), nulls, merged, anew)
            continue
        if value is None and key in base:
            nulls.append((*at, key))
        result[key] = value
    return result


def _is_of_kind(value: dict[str, Any], base: dict[str, Any]) -> bool:
    """Keys of one type mean nothing to another: an object of another type is another object."""
    return "type" not in value or "type" not in base or value["type"] == base["type"]


def _take_away(document: Document, nulls: Iterable[Path]) -> None:
    """Takes away what null was put over, where null is no value of the key."""
    for path in nulls:
        owner: Any = document.value
        field: schema.Field | None = schema.root(owner)
        for key in path[:-1]:
            # What stood above it may be gone, too.
            owner = owner.get(key) if isinstance(owner, dict) else None
            field = None if field is None else schema.child(field, key, owner)
        is_null = isinstance(owner, dict) and owner.get(path[-1], ...) is None
        if is_null and not (field and _takes_null(field, path[-1])):
            del owner[path[-1]]


def mixed(fields: Iterable[schema.Field], source: CfgSource) -> Iterator[Finding]:
    """Finds objects that are one measurement and come from two files.

    Such an object (``x-whole``: a calibration) is whole where a file states it, that is, all of its
    required keys: what the file that it extends says beside them is of another measurement. A file
    that gives fewer keys, or a setting, changes single values; of several at once a warning tells
    what stays, and so it does of intrinsics where a file changes the resolution.
    """
    whole = {field.path: field.keywords["required"] for field in fields
             if field.keywords.get("x-whole")}  # fmt: skip
    places = source.document.values
    for path, over, left in source.merges:
        others = {key: place for key, place in left.items() if places.get((*path, key)) is place}
        files = [place.file for place in others.values()]
        if path in whole and over.issuperset(whole[path]) and others:
            yield Finding(
                path,
                f"{', '.join(others)} would stay from {files[0]}, another calibration: give here "
                "all that differs from the defaults, and take the rest away with null",
            )
        elif (
            path in whole
            and len(over) > 1
            and (stay := [key for key in others if key not in whole[path]])
        ):
            yield Finding(
                path,
                f"{', '.join(stay)} stay from {files[0]}: give the required keys, too "
                f"({', '.join(whole[path])}), if this is another calibration",
                is_warning=True,
            )
        elif "resolution" in over and "intrinsics" in others:
            yield Finding(
                (*path, "resolution"),
                f"the intrinsics of {others['intrinsics'].file} stay as they are: they are of "
                "pictures of the size that is given there",
                is_warning=True,
            )


def _rebase_files(document: Document, folder: FilePath) -> None:
    """Makes the paths that other files give relative to the cfg's folder, as all of them are."""
    fields = list(schema.walk(schema.root(document.value)))
    for field in fields:
        position = document.values[field.path]
        origin = folder_of(FilePath(position.file))
        if "x-file" not in field.keywords or not isinstance(field.value, str) or not position.line:
            continue
        if origin == folder or field.value.startswith(PREFIX) or os.path.isabs(field.value):
            continue
        owner: Any = document.value
        for key in field.path[:-1]:
            owner = owner[key]
        file = origin / field.value
        relative = FilePath(os.path.relpath(file, folder)).as_posix()
        owner[field.path[-1]] = packaged_reference(file) or relative


def _set(document: Document, text: str) -> None:
    """Puts the value of a setting into its place."""
    name, equals, given = text.partition("=")
    position = Position(0, 0, f"--set {text}")
    if not equals or not _SETTING.fullmatch(name):
        raise _fault(position, (), "expected path=value, as in terrain.relief[0].amplitude_m=2")
    if name in (EXTENDS, REPLACES):
        raise _fault(position, (name,), "what a cfg extends and replaces stands in its file")
    if has_half_pair(given):
        raise _fault(position, (), "a string with half a surrogate pair")
    *parents, last = re.findall(r"[^.\[\]]+", name)
    owner, field, at = document.value, schema.root(document.value), Path()
    for word in parents:
        key = _key(owner, word, field, at, position)
        at = (*at, key)
        if isinstance(owner, dict) and key not in owner:
            default = field.keywords["properties"][key].get("default")
            owner[key] = copy.deepcopy(default) if isinstance(default, dict) else {}
            document.keys[at] = position
            _place(document, at, Document(owner[key], {}, {}), position)
        owner = owner[key]
        field = schema.child(field, key, owner) or replace(field, keywords={}, value=owner)
    key = _key(owner, last, field, at, position, new=True)
    at = (*at, key)
    value = _value(given, position)
    described = schema.child(field, key, given)
    if described is not None and described.keywords.get("type") == "string" and given != "null":
        value = value if isinstance(value.value, str) else replace(value, value=given)
    if value.value is None:
        if isinstance(owner, dict) and key not in owner and not _takes_null(field, key):
            raise _fault(position, at, f"no key {shown(key)} to take away{nearest(last, owner)}")
        if isinstance(owner, dict) and not _takes_null(field, key):
            del owner[key]
            return
    owner[key] = value.value
    document.keys[at] = position
    _place(document, at, value, position)


def _takes_null(field: schema.Field, key: str | int) -> bool:
    """Whether null is a value of the key below a field, and no word for leaving it out."""
    below = schema.child(field, key, None)
    return below is not None and schema.is_of(None, below.keywords.get("type", ()))


def _place(document: Document, at: Path, value: Document, position: Position) -> None:
    """Says of a value, and of all below it, that it came by a setting."""
    for path in value.values or {(): position}:
        document.values[(*at, *path)] = position
    for path in value.keys:
        document.keys[(*at, *path)] = position


def _value(given: str, position: Position) -> Document:
    """JSON, or else the word itself."""
    try:
        return json_positions.parse(given.encode(errors="surrogateescape"), position.file)
    except CfgSyntaxError as error:
        if given[:1] in ("[", "{", '"'):
            raise _fault(position, (), error.message) from error
        return Document(given, {(): position}, {})


def _key(
    owner: Any, word: str, field: schema.Field, at: Path, position: Position, new: bool = False
) -> str | int:
    """The key or index that a word of a setting stands for.

    Args:
        owner: What it is looked for in.
        word: The word.
        field: What the schemas say of the owner.
        at: Where the owner stands.
        position: Of the setting.
        new: Whether a key need not be there: the schemas judge it with its value.
    """
    if isinstance(owner, list):
        return _index(owner, word, at, position)
    if not isinstance(owner, dict):
        expected = "expected an object or a list to set something in"
        raise _fault(position, at, f"{shown(owner)}: {expected}")
    known = [k for k, e in field.keywords.get("properties", {}).items() if not e.get("x-ignored")]
    if word in owner or word in known or new:
        return word
    names = [*owner, *(name for name in known if name not in owner)]
    raise _fault(position, (*at, word), f"no key {shown(word)}{nearest(word, names)}")


def _index(owner: list[Any], word: str, at: Path, position: Position) -> int:
    """The index that a word is, or that of the one item which is called so."""
    if word.isdecimal() and int(word) < len(owner):
        return int(word)
    items = [item if isinstance(item, dict) else {} for item in owner]
    found = [i for i, item in enumerate(items) if word in map(item.get, _NAMES)]
    if len(found) == 1:
        return found[0]
    names = [str(item[key]) for item in items for key in _NAMES if key in item]
    guess = closest(word, names)
    why = f"{len(found)} items are called so" if found else f"no item {shown(word)}"
    hint = f"; did you mean {shown(guess)}?" if guess and not found else ""
    indices = f"an index from 0 to {len(owner) - 1}" if owner else "a list that is not empty"
    raise _fault(position, (*at, word), f"{why}: expected {indices}{hint}")
