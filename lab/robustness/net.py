"""Compares what users get with what is recorded: changes of the inside must leave it as it is.

    python lab/robustness/net.py                  compares with lab/robustness/net.json
    python lab/robustness/net.py --whole          stages, reports and annotation, too (minutes)
    python lab/robustness/net.py --write --whole  writes the digests anew
    python lab/robustness/net.py --texts DIR      leaves beside what the digests are of

Each cfg and template that ships has an entry for its digest, its values with defaults filled in,
the streams of randomness that two seeds ask for, and the faults (place, text, order) of some
hundred mistakes in it; the schema and the page of keys have one for each object. Values count, and
the order of keys; the layout of JSON does not. Entries of ``kinds_…`` are of the cfgs in
``net_kinds.json``: objects and kinds of the schema with all keys set, many to distributions. A
commit that changes digests on purpose writes them anew and does nothing else.
"""

from __future__ import annotations

import argparse
import base64
import copy
import hashlib
import importlib.metadata
import json
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np

from scenec.backends.run.render import render
from scenec.compiler.cfg import json_positions
from scenec.compiler.cfg.load import Spec, load
from scenec.compiler.compile import compile_cfg
from scenec.compiler.distributions.numbers import Distribution
from scenec.compiler.distributions.streams import Streams
from scenec.compiler.draw import draw
from scenec.compiler.kinds.schema import bundled
from scenec.schemas.errors import CfgError, ScenecError
from scenec.schemas.frames import read_frame
from scenec.schemas.versions import version_of
from scenec.testing.cfg_reference import make as reference_page

ROOT = Path(__file__).resolve().parents[2]
CONFIGS = ROOT / "configs"
GOLDEN = Path(__file__).with_name("net.json")
KINDS = Path(__file__).with_name("net_kinds.json")
SEEDS = (1, 2)
#: Mistakes of each cfg that are tried.
MISTAKES = 200
#: The same, of each of ``KINDS``.
KINDS_MISTAKES = 60
PASSES = ("depth", "face", "instance", "label", "normal")

Texts = dict[str, str]


def main() -> int:
    """Compares, or writes, the recorded texts."""
    arguments = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    arguments.add_argument("--whole", action="store_true", help="compile and annotate, too")
    arguments.add_argument("--write", action="store_true", help=f"write {GOLDEN.name} anew")
    arguments.add_argument("--texts", type=Path, help="folder for what the digests are of")
    arguments.add_argument("--only", help="cfgs with this in their name")
    options = arguments.parse_args()
    with _of_no_version():
        found = texts(options.whole, options.only or "")
    if options.texts:
        for name, text in found.items():
            file = options.texts / f"{name.replace('/', '.')}.txt"
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_text(text, encoding="utf-8")
    digests = {name: hashlib.sha256(text.encode()).hexdigest()[:20] for name, text in found.items()}
    known = json.loads(GOLDEN.read_text(encoding="utf-8")) if GOLDEN.is_file() else {}
    if options.write:
        GOLDEN.write_text(json.dumps(known | digests, indent=0, sort_keys=True) + "\n", "utf-8")
        print(f"{GOLDEN.name}: {len(digests)} digests written")
        return 0
    differ = [name for name, digest in digests.items() if known.get(name) != digest]
    whole = not options.only
    gone = [name for name in known if whole and name not in digests and _is_asked(name, options)]
    for name in differ:
        print(f"{name}: {'differs' if name in known else 'is new'}")
    for name in gone:
        print(f"{name}: is gone")
    print(f"{len(digests)} digests, {len(differ)} differ, {len(gone)} are gone")
    return int(bool(differ or gone))


@contextmanager
def _of_no_version() -> Iterator[None]:
    """Lets scenec be of version 0: another version changes a line of each stage, and no more."""
    known = importlib.metadata.version
    version_of.cache_clear()
    with mock.patch("importlib.metadata.version", lambda n: "0" if n == "scenec" else known(n)):
        yield
    version_of.cache_clear()


def _is_asked(name: str, options: argparse.Namespace) -> bool:
    return options.whole or not name.startswith("whole/")


def texts(whole: bool, only: str = "") -> Texts:
    """Returns the compared texts, by name."""
    found = {} if only else {**_schema(), **_page()}
    for file in sorted([*CONFIGS.glob("*.json"), *CONFIGS.glob("templates/*.jsonc")]):
        if only not in file.stem:
            continue
        spec = load(file)
        found |= _texts(spec, MISTAKES)
        if whole:
            for seed in SEEDS:
                found |= {f"whole/{file.stem}/{seed}/{k}": v for k, v in _made(spec, seed).items()}
        print(f"{file.stem}: done", file=sys.stderr)
    with tempfile.TemporaryDirectory() as folder:
        for file in _kinds(Path(folder)):
            if only in file.stem:
                found |= _texts(load(file), KINDS_MISTAKES)
    return found


def _texts(spec: Spec, mistakes: int) -> Texts:
    """Returns what is compared of each cfg before it is compiled."""
    return {
        f"spec/{spec.path.stem}": spec.digest,
        f"filled/{spec.path.stem}": _json(spec.cfg),
        f"streams/{spec.path.stem}": _streams(spec),
        f"faults/{spec.path.stem}": "\n".join(_faults(spec.path, mistakes)),
    }


def _kinds(folder: Path) -> Iterator[Path]:
    """Writes the cfgs of ``KINDS`` and the files that they name into a folder; yields the cfgs."""
    made = json.loads(KINDS.read_text(encoding="utf-8"))
    for name, content in made["files"].items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(base64.b64decode(content))
    for number, cfg in enumerate(made["cfgs"]):
        file = folder / f"kinds_{number:02}.json"
        file.write_text(json.dumps(cfg), encoding="utf-8")
        yield file


def _json(value: Any) -> str:
    """Writes a value as JSON, keys in their order."""

    def other(of: Any) -> Any:
        if isinstance(of, Distribution):
            return of.as_dict()
        raise TypeError(type(of))

    return json.dumps(value, indent=1, ensure_ascii=False, default=other)


def _sorted(value: Any, by_key: bool = True) -> Any:
    """Returns a schema whose keywords are sorted; the order of a cfg's keys stays."""
    if isinstance(value, list):
        return [_sorted(entry) for entry in value]
    if not isinstance(value, dict):
        return value
    # Where checks are found is no matter of the cfg; no required key is as good as no such word.
    kept = {
        k: v
        for k, v in value.items()
        if k not in ("x-check", "x-fill") and (k, v) != ("required", [])
    }
    made = {key: _sorted(entry, key != "properties") for key, entry in kept.items()}
    return dict(sorted(made.items())) if by_key else made


def _schema() -> Texts:
    """Returns each definition of the bundled schema, full and partial."""
    found = {}
    for name, partial in (("schema", False), ("partial", True)):
        schema = _sorted(bundled(partial=partial))
        of = schema.pop("$defs")
        found[f"{name}/root"] = _json(schema)
        found[f"{name}/order"] = _json(list(of))
        found |= {f"{name}/{key}": _json(value) for key, value in of.items()}
    return found


def _page() -> Texts:
    """Returns each section of the page of keys."""
    head, *sections = reference_page().split("\n## ")
    return {"page/head": head} | {f"page/{s.partition(chr(10))[0]}": s for s in sections}


def _streams(spec: Spec) -> str:
    """Lists every stream that drawing asks for, whatever the order, with what came of it."""
    lines: list[str] = []
    uniforms, key = Streams.uniforms, Streams.key

    def asked_uniforms(self: Streams, path: str, n: int, sample: int | None = None) -> Any:
        values = uniforms(self, path, n, sample)
        digest = hashlib.sha256(np.ascontiguousarray(values).tobytes()).hexdigest()[:12]
        if n:
            lines.append(f"uniforms {path} {n} {sample} {digest}")
        return values

    def asked_key(self: Streams, path: str, sample: int | None = None) -> int:
        value = key(self, path, sample)
        lines.append(f"key {path} {sample} {value}")
        return value

    with mock.patch.multiple(Streams, uniforms=asked_uniforms, key=asked_key):
        for seed in SEEDS:
            before = len(lines)
            try:
                draw(spec, seed, 0, 0)
            except ScenecError as error:
                lines.append(f"fault {error}")
            # How often a stream is asked for changes nothing, nor does asking for no number.
            lines[before:] = [f"seed {seed}", *sorted(set(lines[before:]))]
    return "\n".join(lines)


def _faults(file: Path, mistakes: int) -> Iterator[str]:
    """Yields the messages about a cfg with each of some mistakes in it."""
    cfg = json_positions.parse(file.read_bytes()).value
    tried = [(at, name) for at in _places(cfg, ()) for name in _MISTAKES]
    # Spread over all of the cfg, the same ones each time.
    step = max(1, len(tried) // mistakes)
    with tempfile.TemporaryDirectory() as folder:
        for at, name in tried[::step]:
            wrong = copy.deepcopy(cfg)
            if not _MISTAKES[name](wrong, at):
                continue
            place = Path(folder) / file.name
            # Files that it names are beside the original.
            place.write_text(json.dumps(_absolute(wrong, file.parent), indent=1), "utf-8")
            try:
                said = [str(fault) for fault in load(place).warnings]
            except CfgError as error:
                said = [str(fault) for fault in error.faults]
            yield f"{'/'.join(map(str, at))} {name}"
            for line in said:
                yield "  " + line.replace(folder, "").replace(str(file.parent), "")


def _places(value: Any, at: tuple[Any, ...]) -> Iterator[tuple[Any, ...]]:
    """Yields every place of a document but its root."""
    items = value.items() if isinstance(value, dict) else enumerate(value)
    for key, child in items:
        yield (*at, key)
        if isinstance(child, dict | list):
            yield from _places(child, (*at, key))


def _absolute(value: Any, folder: Path) -> Any:
    """Returns the same with the names of existing files made absolute."""
    if isinstance(value, dict):
        return {key: _absolute(child, folder) for key, child in value.items()}
    if isinstance(value, list):
        return [_absolute(child, folder) for child in value]
    if isinstance(value, str) and "." in value and (folder / value).is_file():
        return str(folder / value)
    return value


def _owner(cfg: Any, at: tuple[Any, ...]) -> Any:
    for key in at[:-1]:
        cfg = cfg[key]
    return cfg


def _put(value: Any) -> Callable[[Any, tuple[Any, ...]], bool]:
    def change(cfg: Any, at: tuple[Any, ...]) -> bool:
        owner = _owner(cfg, at)
        if type(owner[at[-1]]) is type(value) and owner[at[-1]] == value:
            return False
        owner[at[-1]] = value
        return True

    return change


def _take(cfg: Any, at: tuple[Any, ...]) -> bool:
    del _owner(cfg, at)[at[-1]]
    return True


def _misspell(cfg: Any, at: tuple[Any, ...]) -> bool:
    """Swaps two letters of a key; its place among the others stays."""
    owner, key = _owner(cfg, at), at[-1]
    if not isinstance(owner, dict) or len(key) < 4 or key[1] == key[2]:
        return False
    wrong = key[0] + key[2] + key[1] + key[3:]
    items = [(wrong if name == key else name, value) for name, value in owner.items()]
    owner.clear()
    owner.update(items)
    return True


def _misspell_value(cfg: Any, at: tuple[Any, ...]) -> bool:
    owner = _owner(cfg, at)
    if not isinstance(owner[at[-1]], str) or len(owner[at[-1]]) < 4:
        return False
    owner[at[-1]] = owner[at[-1]][:-1]
    return True


_MISTAKES: dict[str, Callable[[Any, tuple[Any, ...]], bool]] = {
    "is a word": _put("nonsense"),
    "is null": _put(None),
    "is negative": _put(-1.5),
    "is huge": _put(1e15),
    "is an object": _put({"type": "nonsense"}),
    "is a list": _put([1, 2, 3]),
    "is missing": _take,
    "is misspelled": _misspell,
    "has a misspelled value": _misspell_value,
}


def _made(spec: Spec, seed: int) -> Texts:
    """Returns files of the first batch, its report by key, and the first sample's annotation."""
    found = {}
    with tempfile.TemporaryDirectory() as scratch:
        out = Path(scratch, "out")
        try:
            compile_cfg(spec, seed=seed, out=out, batches=range(1))
        except ScenecError as error:
            return {"fault": str(error).replace(scratch, "")}
        manifest = json.loads((out / "manifest.json").read_text(encoding="utf-8"))
        found |= {f"file/{name}": _json(entry) for name, entry in manifest["files"].items()}
        report = json.loads((out / "batch_0000" / "report.json").read_text(encoding="utf-8"))
        found |= {f"report/{key}": _json(value) for key, value in report.items()}
        for path in render(out, "annotation", passes=PASSES, samples=range(1)).frames:
            frame = read_frame(path)
            for name, values in sorted(frame.passes.items()):
                digest = hashlib.sha256(np.ascontiguousarray(values).tobytes()).hexdigest()
                found[f"frame/{path.parent.name}/{name}"] = digest
    return found


if __name__ == "__main__":
    sys.exit(main())
