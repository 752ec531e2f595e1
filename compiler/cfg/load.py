"""From a cfg file to a Spec, or to all that is wrong with it."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path as FilePath

from scenec.compiler.cfg.check_files import check_files
from scenec.compiler.cfg.check_names import check_names
from scenec.compiler.cfg.check_numbers import check_number
from scenec.compiler.cfg.check_schema import check_schema
from scenec.compiler.cfg.faults import locate
from scenec.compiler.cfg.fill import Cfg, fill
from scenec.compiler.cfg.magnitudes import unusual
from scenec.compiler.cfg.slips import improbable
from scenec.compiler.cfg.sources import folder_of, located, mixed, read
from scenec.compiler.distributions.numbers import Distribution
from scenec.compiler.kinds import Finding, InputFile, Node, schema
from scenec.compiler.kinds.node import Tree
from scenec.compiler.kinds.schema import Field
from scenec.compiler.kinds.table import loaded
from scenec.schemas.codec import Facts, JsonObject
from scenec.schemas.errors import CfgError, Fault, PluginError
from scenec.schemas.plugins import blaming, load_kind, named
from scenec.schemas.presets import with_presets
from scenec.schemas.spelling import shown


@dataclass(frozen=True)
class Spec:
    """A validated cfg.

    Attributes:
        cfg: The cfg in full (see ``fill``): numbers as float, int or
            ``Distribution``, keys without a value and default as None. Not to be changed.
        path: The cfg file.
        files: The files that it names, by the path of the string: "terrain/relief/0/file".
        digest: sha256 over the cfg in full and the hashes of its files, in hexadecimal. It does not
            depend on syntax, layout, comments or where the files lie, but on the order of named
            things, which decides instance ids.
        text: The cfg as JSON, with all that it extends and its settings.
        is_verbatim: Whether that is the file's own bytes.
        settings: What was set over it.
        warnings: Values that can be and are probably a slip, or leave nothing to see; files of
            unsound geometry.
        plugins: Packages of the kinds that are not scenec's own (``schema.origins``).
        folder: What its files are relative to.
    """

    cfg: Cfg
    path: FilePath
    files: Mapping[str, InputFile]
    digest: str
    text: bytes
    is_verbatim: bool = True
    settings: tuple[str, ...] = ()
    warnings: tuple[Fault, ...] = ()
    plugins: Mapping[str, str] = field(default_factory=dict)
    folder: FilePath = FilePath()


def load(path: FilePath | str, settings: Sequence[str] = (), text: bytes | None = None) -> Spec:
    """Reads and validates a cfg.

    Args:
        path: The file, or ``package:configs/NAME``; see ``sources.read``.
        settings: What is set over it, each ``path=value``.
        text: JSON in place of the file's content; the file need not be there.

    Raises:
        CfgError: With every fault of the file, in its order; of a text that cannot be read, the
            first.
    """
    path = located(FilePath(path))
    source = read(path, settings, text)
    document = replace(source.document, value=with_presets(source.document.value))
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
    mixes = list(mixed(fields, source))
    findings = [*duplicates, *schema_findings, *number_findings]
    findings += [finding for finding in mixes if not finding.is_warning]
    findings += check_names(cfg, sound=not (duplicates or schema_findings))
    findings += _check_kinds(fields, cfg)
    folder = folder_of(path)
    files, file_findings = check_files(fields, cfg, folder)
    findings += [finding for finding in file_findings if not finding.is_warning]
    findings += _check_kinds(fields, cfg, files)
    faults = locate(findings, document)
    if faults:
        raise CfgError(faults)
    filled = fill(document.value)
    plugins = schema.origins(fields)
    digest = digest_of(filled, files, plugins)
    told = [finding for finding in (*mixes, *file_findings) if finding.is_warning]
    warnings = tuple(sorted(locate([*improbable(fields), *unusual(cfg), *told], document)))
    return Spec(
        filled,
        path,
        files,
        digest,
        source.text,
        source.is_verbatim,
        tuple(settings),
        warnings,
        plugins,
        folder,
    )


def _check_kinds(
    fields: Iterable[Field], cfg: Node, files: Mapping[str, InputFile] | None = None
) -> Iterator[Finding]:
    """Yields what the ``check`` of each object finds that the cfg names; no other is imported.

    Args:
        fields: All places of the cfg; the keyword "x-check" says which class has a check,
            "x-offered" which one of another package.
        cfg: The whole.
        files: Those that nothing is wrong with, by path: asked is then ``check_files``, of classes
            that have it.
    """
    for place in fields:
        if "x-check" in place.keywords and (node := cfg.at(*place.path)):
            kind = loaded(place.keywords["x-check"])
            if files is None:
                yield from kind.check(node)
            elif hasattr(kind, "check_files"):
                yield from kind.check_files(node, files)
        if files is None and "x-offered" in place.keywords and (node := cfg.at(*place.path)):
            group, name = place.keywords["x-offered"]
            yield from _offered_findings(group, name, node)


def _offered_findings(group: str, name: str, node: Node) -> list[Finding]:
    """Returns what the ``check`` of another package's kind finds, or what is wrong with it."""
    try:
        with blaming():
            made = load_kind(group, name).check(node)
            # It may end without a word.
            found = [] if made is None else [*made] if isinstance(made, Iterable) else [made]
    except PluginError as error:
        return [node.fault(str(error))]
    for one in found:
        if not isinstance(one, Finding):
            who = named(group, name)
            return [node.fault(f"{who}: check gave {one!r:.60}: expected what node.fault returns")]
    return found


def digest_of(cfg: JsonObject, files: Mapping[str, InputFile], plugins: Mapping[str, str]) -> str:
    """sha256 over a cfg, or a part of one, the hashes of its files, and packages; see ``Spec``."""
    content: JsonObject = {"cfg": cfg, "files": {name: file.sha256 for name, file in files.items()}}
    if plugins:
        content["plugins"] = plugins
    # Keys are not sorted: the order of objects decides their instance ids.
    text = json.dumps(
        content, ensure_ascii=True, allow_nan=False, separators=(",", ":"), default=_as_json
    )
    return hashlib.sha256(text.encode("ascii")).hexdigest()


def _as_json(value: object) -> Facts:
    if isinstance(value, Distribution):
        return value.as_dict()
    raise TypeError(f"{type(value)} in a cfg")
