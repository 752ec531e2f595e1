"""Under which terms the files that a cfg names may be used, as far as they say so themselves.

Looked up in this order, the first answer counts:

1. ``<file>.license`` beside it, and ``REUSE.toml`` in its folder or one above, up to that of the
   checkout (https://reuse.software/spec-3.3): ``SPDX-License-Identifier``,
   ``SPDX-FileCopyrightText``.
2. A text called license or copying in the folder of a file that an installed package brings: its
   first line.
3. The metadata of that package.
4. ``asset.copyright`` of a glTF model: who made it, not under which terms.

What nothing is said of is unknown, and said to be.
"""

from __future__ import annotations

import importlib.metadata
import json
import re
import struct
import tomllib
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from scenec.compiler.cfg.resources import PREFIX, distribution_of
from scenec.compiler.kinds.context import InputFile
from scenec.schemas.codec import Facts

_LICENSE = re.compile(r"SPDX-License-Identifier:[ \t]*(.+)")
_COPYRIGHT = re.compile(r"SPDX-FileCopyrightText:[ \t]*(.+)")
_TEXTS = re.compile(r"(licen[cs]e|copying)([.\-_].*)?", re.IGNORECASE)
_LONGEST = 200
_GLB = b"glTF"


@dataclass(frozen=True)
class License:
    """Holds what is known of a file's license.

    Attributes:
        license: SPDX expression, or what stands in the place of one; None where it is unknown.
        copyright: Whose it is, a line each.
        source: Where that is said; "" where it is not.
    """

    license: str | None = None
    copyright: tuple[str, ...] = ()
    source: str = ""


def terms(file: InputFile) -> License:
    """The terms of a file that a cfg names; of a folder, those that its files share."""
    if file.path.is_dir():
        found = {_said(path) for path in sorted(file.path.iterdir()) if path.is_file()} - {None}
        if len(found) == 1:
            return next(iter(found)) or License()
    else:
        said = _said(file.path)
        if said is not None:
            return said
    if file.reference.startswith(PREFIX):
        return _of_package(file)
    return _of_gltf(file.path) or License()


def as_json(file: InputFile) -> Facts:
    """The same as it stands in the manifest, with the file's name as the cfg has it."""
    name = file.reference
    if not name.startswith(PREFIX) and Path(name).is_absolute():
        # A path of one machine goes into no output.
        name = Path(name).name
    found = terms(file)
    return {
        "file": name,
        "license": found.license,
        "copyright": list(found.copyright),
        "source": found.source,
    }


def _said(path: Path) -> License | None:
    """Reads the terms in ``<file>.license`` or a ``REUSE.toml``."""
    beside = path.with_name(path.name + ".license")
    text = _text(beside)
    if text is not None:
        return License(
            _joined(match.strip() for match in _LICENSE.findall(text)),
            tuple(match.strip() for match in _COPYRIGHT.findall(text)),
            f"{beside.name} beside it",
        )
    path = path.resolve()
    for folder in path.parents:
        text = _text(folder / "REUSE.toml")
        found = None if text is None else _annotated(text, path.relative_to(folder).as_posix())
        if found is not None:
            return found
        if (folder / ".git").exists():
            break
    return None


def _annotated(text: str, name: str) -> License | None:
    """The last annotation of a REUSE.toml whose path matches."""
    try:
        annotations = tomllib.loads(text).get("annotations", [])
    except tomllib.TOMLDecodeError:
        return None
    found = None
    for annotation in annotations if isinstance(annotations, list) else ():
        if any(_matches(name, pattern) for pattern in _lines(annotation.get("path"))):
            found = License(
                _joined(_lines(annotation.get("SPDX-License-Identifier"))),
                tuple(_lines(annotation.get("SPDX-FileCopyrightText"))),
                "REUSE.toml",
            )
    return found


def _matches(name: str, pattern: str) -> bool:
    """Globs of REUSE.toml: ``*`` stays within a folder, ``**`` does not."""
    regex = "".join(
        {"**": ".*", "*": "[^/]*"}.get(part) or re.escape(part)
        for part in re.split(r"(\*\*|\*)", pattern)
    )
    return re.fullmatch(regex, name) is not None


def _of_package(file: InputFile) -> License:
    name = file.reference.removeprefix(PREFIX).partition("/")[0]
    folder = file.path if file.path.is_dir() else file.path.parent
    # Beside the package's own code, a license is the package's: its metadata say it better.
    if folder.name != name:
        for path in sorted(folder.iterdir()):
            if _TEXTS.fullmatch(path.name):
                text = _text(path) or ""
                first = next((line.strip() for line in text.splitlines() if line.strip()), "")
                return License(first[:_LONGEST] or None, (), f"{path.name} beside it")
    distribution = distribution_of(name)
    try:
        metadata = importlib.metadata.metadata(distribution)
    except importlib.metadata.PackageNotFoundError:
        return License()
    said = metadata.get("License-Expression") or ""
    text = (metadata.get("License") or "").strip()
    if not said and text and "\n" not in text:
        said = text
    if not said:
        classes = [c for c in metadata.get_all("Classifier") or [] if c.startswith("License ::")]
        said = "; ".join(c.rpartition(" :: ")[2] for c in classes) or text.partition("\n")[0]
    return License(said.strip()[:_LONGEST] or None, (), f"metadata of the package {distribution}")


def _of_gltf(path: Path) -> License | None:
    """``asset.copyright`` of a glTF file, from its JSON alone."""
    if path.suffix.lower() not in (".glb", ".gltf"):
        return None
    try:
        with path.open("rb") as file:
            head = file.read(20)
            if head[:4] == _GLB and len(head) == 20:
                document = json.loads(file.read(struct.unpack("<I", head[12:16])[0]))
            else:
                document = json.loads(head + file.read())
        owner = document["asset"]["copyright"]
    except (OSError, ValueError, KeyError, TypeError):
        return None
    return License(None, (str(owner)[:_LONGEST],), "asset.copyright in the file") if owner else None


def _text(path: Path) -> str | None:
    try:
        return path.read_text(encoding="utf-8", errors="replace")
    except OSError:
        return None


def _lines(value: Any) -> list[str]:
    values = value if isinstance(value, list) else [value]
    return [str(text) for text in values if text]


def _joined(identifiers: Iterable[str]) -> str | None:
    """Several identifiers all hold."""
    return " AND ".join(dict.fromkeys(identifiers)) or None
