"""Many cfgs from one: a grid of settings and seeds, each point an output folder of its own."""

from __future__ import annotations

import hashlib
import itertools
import json
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from scenec.compiler.cfg.load import Spec, load
from scenec.compiler.compile import compile_cfg
from scenec.compiler.output import held
from scenec.compiler.views.needed import Keep
from scenec.schemas.codec import Facts
from scenec.schemas.errors import CfgError, Fault, OutputError, ScenecError
from scenec.schemas.manifest import MANIFEST
from scenec.schemas.units import Keeper

#: Longer names of folders are cut; what is cut off stands in the table.
_LONGEST_NAME, _LONGEST_VALUE = 120, 32
#: Each is a folder, and a line of a table that is written after each of them.
_MOST_POINTS = 100_000


@dataclass(frozen=True)
class SweepPoint:
    """One cfg and seed.

    Attributes:
        name: Of its folder: what differs between points, and its value.
        settings: Each ``path=value``, as ``load`` takes them.
    """

    name: str
    settings: tuple[str, ...]
    seed: int

    @property
    def values(self) -> Facts:
        """Value by path; a word that is no JSON stands for itself."""
        pairs = (setting.partition("=") for setting in self.settings)
        return {path: _typed(value) for path, _, value in pairs}


def points(
    lists: Sequence[str], seeds: Sequence[int], *, in_step: bool = False
) -> list[SweepPoint]:
    """All points, the last list and then the seed changing fastest.

    Args:
        lists: Each ``path=value,value,…``; commas inside of brackets and strings are the value's.
        seeds: Of every combination.
        in_step: Whether the first values of all lists belong together, then the second ones, and
            so on, rather than each with each; lists of one value hold for all.

    Raises:
        ScenecError: A list has no value, or stands twice; lists in step are not equally long; there
            are too many points.
    """
    values: dict[str, list[str]] = {}
    for text in lists:
        path, equals, given = text.partition("=")
        if not equals or path in values:
            why = "is set twice" if equals else "expected path=value,value,…"
            raise ScenecError(f"--set {text}: {why}")
        values[path] = list(dict.fromkeys(split(given)))
    many = {path: given for path, given in values.items() if len(given) > 1}
    if in_step:
        lengths = {path: len(given) for path, given in many.items()}
        if len(set(lengths.values())) > 1:
            told = ", ".join(f"{length} of {path}" for path, length in lengths.items())
            raise ScenecError(f"--zip: lists in step are equally long; there are {told}")
        longest = max(lengths.values(), default=1)
        _require_few(longest * len(seeds))
        full = [given * longest if len(given) == 1 else given for given in values.values()]
        rows = list(zip(*full, strict=True)) or [()]
    else:
        _require_few(math.prod(map(len, values.values())) * len(seeds))
        rows = list(itertools.product(*values.values()))
    labels = dict(zip(many, _labels(list(many)), strict=True))
    words = {path: dict(zip(given, _words(given), strict=True)) for path, given in many.items()}
    found = []
    for row in rows:
        chosen = dict(zip(values, row, strict=True))
        parts = [f"{labels[path]}={words[path][chosen[path]]}" for path in many]
        settings = tuple(f"{path}={value}" for path, value in chosen.items())
        for seed in seeds:
            own = [*parts, f"seed={seed}"] if len(seeds) > 1 or not parts else parts
            found.append(SweepPoint(_short("_".join(own)), settings, seed))
    return found


def _require_few(count: int) -> None:
    if count > _MOST_POINTS:
        raise ScenecError(
            f"a sweep of {count:,} points: expected at most {_MOST_POINTS:,}; make several"
        )


def _typed(value: str) -> Any:
    try:
        return json.loads(value)
    except ValueError:
        return value


def split(text: str) -> list[str]:
    """Values between commas; those inside of brackets and strings are part of a value."""
    found, depth, quoted, escaped = [""], 0, False, False
    for letter in text:
        if quoted:
            quoted = escaped or letter != '"'
            escaped = letter == "\\" and not escaped
        elif letter == '"':
            quoted = True
        else:
            depth += (letter in "[{") - (letter in "]}")
            if letter == "," and depth == 0:
                found.append("")
                continue
        found[-1] += letter
    return [value.strip() for value in found]


def _labels(paths: Sequence[str]) -> list[str]:
    """The last words of each path, as many as tell it from the others."""
    words = [re.findall(r"[^.\[\]]+", path) for path in paths]
    for count in range(1, max(map(len, words), default=0) + 1):
        labels = [".".join(word[-count:]) for word in words]
        if len(set(labels)) == len(paths):
            return labels
    return [".".join(word) for word in words]


def _words(values: Sequence[str]) -> list[str]:
    """Values as a part of a folder's name."""
    words = [re.sub(r"[^A-Za-z0-9.+-]+", "_", value).strip("_.") for value in values]
    words = [word[:_LONGEST_VALUE] for word in words]
    if len(set(words)) == len(words) and all(words):
        return words
    return [f"{word}.{i}" for i, word in enumerate(words)]


def _short(name: str) -> str:
    if len(name) <= _LONGEST_NAME:
        return name
    return f"{name[:_LONGEST_NAME]}_{hashlib.sha256(name.encode()).hexdigest()[:8]}"


def read_all(cfg: Path | str, swept: Sequence[SweepPoint], text: bytes | None = None) -> list[Spec]:
    """The cfg of every point.

    Args:
        cfg: The file.
        swept: The points.
        text: As of ``load``.

    Raises:
        CfgError: Some have faults; each fault is told once.
    """
    specs: dict[tuple[str, ...], Spec] = {}
    faults: dict[Fault, None] = {}
    for point in swept:
        if point.settings not in specs:
            try:
                specs[point.settings] = _absolute(load(cfg, point.settings, text))
            except CfgError as error:
                faults |= dict.fromkeys(error.faults)
    if faults:
        raise CfgError(list(faults))
    return [specs[point.settings] for point in swept]


def _absolute(spec: Spec) -> Spec:
    """Makes all paths of a cfg absolute: its worker may be in another folder."""
    files = {
        key: replace(
            file,
            path=file.path.absolute(),
            members=tuple((path.absolute(), digest) for path, digest in file.members),
        )
        for key, file in spec.files.items()
    }
    return replace(spec, path=spec.path.absolute(), files=files, folder=spec.folder.absolute())


@dataclass(frozen=True)
class CompilePoint:
    """Compiles all batches of a point into its folder; returns nothing.

    Attributes:
        spec: The cfg, as it was read for the point (``read_all``).
        point: What is set over it, and the seed.
        out: The folder, absolute.
        keep, batches, cache, replace, faults: As of ``compile_cfg``.
    """

    spec: Spec
    point: SweepPoint
    out: Path
    keep: Keep
    batches: range | None
    cache: Path | None
    replace: bool
    faults: str

    @property
    def what(self) -> str:
        """In messages."""
        return self.point.name

    @property
    def holds(self) -> None:
        """Nothing: each point is another cfg."""
        return None

    def run(self, keeper: Keeper) -> None:
        """Compile it.

        Raises:
            ScenecError: See ``compile_cfg``; a batch that cannot be built, too.
        """
        report = compile_cfg(
            self.spec,
            seed=self.point.seed,
            out=self.out,
            batches=self.batches,
            keep=self.keep,
            cache=self.cache,
            replace=self.replace,
            faults=self.faults,
        )
        if report.failed:
            name, reason = next(iter(report.failed.items()))
            raise ScenecError(f"{name} cannot be built: {reason}")

    def is_done(self) -> bool:
        """Whether the folder holds all of it.

        Raises:
            OutputError: It holds something else, which is not to be replaced.
        """
        if not (self.out / MANIFEST).exists():
            return False
        there, other = held(self.out, self.spec, self.point.seed, self.keep)
        if other and not self.replace:
            raise OutputError(
                f"{self.out}: holds batches {other}; --replace throws them away, or choose another "
                "folder"
            )
        wanted = self.batches or range(int(self.spec.cfg["batches"]))
        return not other and there >= set(wanted)
