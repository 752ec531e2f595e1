"""From a cfg file to a Spec, or to all that is wrong with it."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path as FilePath
from typing import Any

from scenec.compiler.cfg import schema
from scenec.compiler.cfg.check_files import InputFile, check_files
from scenec.compiler.cfg.check_light import check_light
from scenec.compiler.cfg.check_materials import check_materials
from scenec.compiler.cfg.check_names import check_names
from scenec.compiler.cfg.check_numbers import check_number
from scenec.compiler.cfg.check_objects import check_objects, check_parts
from scenec.compiler.cfg.check_rigs import check_rigs
from scenec.compiler.cfg.check_schema import check_schema
from scenec.compiler.cfg.check_terrain import check_terrain
from scenec.compiler.cfg.faults import Finding, locate
from scenec.compiler.cfg.fill import fill
from scenec.compiler.cfg.json_positions import Document, JsonError, parse
from scenec.compiler.cfg.node import Node, Tree
from scenec.compiler.cfg.typed import Cfg
from scenec.compiler.distributions.numbers import Distribution
from scenec.schemas.errors import CfgError, Fault
from scenec.schemas.spelling import shown

#: What must hold between keys, beside what is checked of names and files.
_CHECKS = (check_terrain, check_materials, check_objects, check_light, check_rigs)


@dataclass(frozen=True)
class Spec:
    """A validated cfg.

    Attributes:
        cfg: The cfg in full (see ``fill`` and ``typed``): numbers as float, int or
            ``Distribution``, keys without a value and default as None. Not to be changed.
        path: The cfg file.
        files: The files that it names, by the path of the string: "terrain/relief/0/file".
        digest: sha256 over the cfg in full and the hashes of its files, in hexadecimal. It does not
            depend on layout, comments or where the files lie, but on the order of named things,
            which decides instance ids.
        text: The file's bytes.
        plugins: Packages of the kinds that are not scenec's own (``schema.origins``).
    """

    cfg: Cfg
    path: FilePath
    files: Mapping[str, InputFile]
    digest: str
    text: bytes
    plugins: Mapping[str, str] = field(default_factory=dict)


def load(path: FilePath | str) -> Spec:
    """Reads and validates a cfg.

    Raises:
        CfgError: With every fault of the file, in its order; of a text that is not JSON, the first.
    """
    path = FilePath(path)
    name = str(path)
    text, document = _read(path, name)
    duplicates = [
        Finding(at, f"the key {shown(at[-1])} stands twice in its object", position=position)
        for at, position in document.duplicates
    ]
    fields = list(schema.walk(schema.root(document.value)))
    schema_findings = check_schema(fields)
    tree = Tree(fields, schema_findings)
    number_findings = [
        finding
        for field in fields
        if field.is_number and tree.is_sound(field.path)
        for finding in check_number(field)
    ]
    cfg = Node(Tree(fields, [*schema_findings, *number_findings]))
    findings = [*duplicates, *schema_findings, *number_findings]
    findings += check_names(cfg, sound=not (duplicates or schema_findings))
    for check in _CHECKS:
        findings += check(cfg)
    files, file_findings = check_files(fields, cfg, path.parent)
    findings += [*file_findings, *check_parts(cfg, files)]
    faults = locate(findings, document, name)
    if faults:
        raise CfgError(faults)
    filled = fill(document.value)
    plugins = schema.origins(fields)
    digest = digest_of(filled, files, plugins)
    return Spec(filled, path, files, digest, text, plugins)


def _read(path: FilePath, name: str) -> tuple[bytes, Document]:
    try:
        data = path.read_bytes()
    except OSError as error:
        raise CfgError([Fault(name, 1, 1, "", error.strerror or str(error))]) from error
    except ValueError as error:
        # A zero character in the name.
        raise CfgError([Fault(name, 1, 1, "", f"not a file name: {error}")]) from error
    try:
        return data, parse(data)
    except JsonError as error:
        line, column = error.position.line, error.position.column
        raise CfgError([Fault(name, line, column, "", error.message)]) from error


def digest_of(
    cfg: Mapping[str, Any], files: Mapping[str, InputFile], plugins: Mapping[str, str]
) -> str:
    """sha256 over a cfg, or a part of one, the hashes of its files, and packages; see ``Spec``."""
    content = {"cfg": cfg, "files": {name: file.sha256 for name, file in files.items()}}
    if plugins:
        content["plugins"] = plugins
    # Keys are not sorted: the order of objects decides their instance ids.
    text = json.dumps(
        content,
        ensure_ascii=True,
        allow_nan=False,
        separators=(",", ":"),
        default=_as_json,
    )
    return hashlib.sha256(text.encode("ascii")).hexdigest()


def _as_json(value: object) -> dict[str, Any]:
    if isinstance(value, Distribution):
        return value.as_dict()
    raise TypeError(f"{type(value)} in a cfg")
