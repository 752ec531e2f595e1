"""Defines what a kind is drawn from: the batch's streams, and what its part refers to."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.distributions.numbers import Number
from scenec.compiler.distributions.resolve import per_sample
from scenec.compiler.distributions.streams import Streams
from scenec.compiler.kinds.declare import keys_of
from scenec.schemas.codec import JsonObject
from scenec.schemas.georeference import Georeference

#: A number of each sample, or a list of numbers, once it is drawn: float64 [samples, ...].
type Array = NDArray[np.float64]


@dataclass(frozen=True)
class InputFile:
    """A file that the cfg names.

    Attributes:
        path: Where it is on this machine, a file or a folder; never written to any output.
        sha256: Of its bytes, in hexadecimal; with those of the files that belong to a model.
        reference: The string in the cfg.
        members: All files that are read for it, and the digest of each.
    """

    path: Path
    sha256: str
    reference: str = ""
    members: tuple[tuple[Path, str], ...] = ()


@dataclass(frozen=True)
class Context:
    """Holds what a part of the cfg is drawn from, and what it refers to beyond itself.

    Attributes:
        streams: The batch's.
        ground: The cfg's ground layers, resolved.
        relief: Operators before the part.
        label_table: The cfg's labels: per level, name -> id.
        georeference: Returns where on a body the terrain lies; None where no DEM of it says so.
        between: Whether poses are asked for between the samples, too: while a shutter is open.
        path: Of what is drawn: "terrain/relief/0".
        samples: How many the batch has.
        choice: Which it is one of (``table.CHOICES``): a kind may be other in another.
        spacing_m: Of the samples of the relief.
    """

    streams: Streams
    size_m: tuple[float, float] = (1.0, 1.0)
    files: Mapping[str, InputFile] = field(default_factory=dict)
    ground: Sequence[JsonObject] = ()
    relief: Sequence[Any] = ()
    label_table: Mapping[str, Mapping[str, int]] = field(default_factory=dict)
    georeference: Callable[[], Georeference | None] = lambda: None
    path: str = ""
    samples: int = 1
    between: bool = False
    choice: str = ""
    spacing_m: float = 1.0

    def at(self, path: str) -> Context:
        """Returns the context of what is drawn at a place."""
        return replace(self, path=path)

    def key(self, below: str = "") -> int:
        """Returns the noise key of what is drawn, or of something below it."""
        return self.streams.key(f"{self.path}/{below}" if below else self.path)

    def uniforms(self, below: str, n: int, columns: int) -> Array:
        """Returns uniform numbers, [n, columns]; a larger n leaves the first rows as they are."""
        return self.streams.uniforms(f"{self.path}/{below}", n * columns).reshape(n, columns)

    def label_ids(self, choice: Mapping[str, str]) -> dict[str, int]:
        """Returns label ids of a choice of names, on every level; 0 where it chooses none."""
        return {
            level: table[choice[level]] if level in choice else 0
            for level, table in self.label_table.items()
        }

    def per_sample(self, number: Number, below: str) -> NDArray[np.float64]:
        """Returns a number of what is drawn at each sample, float64 [s]."""
        return per_sample(number, self.streams, f"{self.path}/{below}", self.samples)

    def sampled(self, kind: Any) -> dict[str, Any]:
        """Returns what is drawn once a sample, at every sample, by key.

        Args:
            kind: A kind or an object that stands at ``path``; what it has none of is left out.
        """
        return {
            name: per_sample(value, self.streams, f"{self.path}/{name}", self.samples)
            for name, keywords in _keywords_of(type(kind)).items()
            if _is_of_samples(keywords) and not isinstance(value := getattr(kind, name), str | None)
        }

    def layers_of(self, node: JsonObject) -> tuple[int, ...]:
        """Ground layers that a condition by material names: one, or all of its material."""
        if node["layer"] is not None:
            return (node["layer"],)
        return tuple(i for i, own in enumerate(self.ground) if own["material"] == node["material"])


def _keywords_of(kind: type[Any]) -> Mapping[str, Mapping[str, Any]]:
    """Returns what the schema says of a kind's keys; another package's may say it itself."""
    if not hasattr(kind, "SCHEMA"):
        return {name: declared.form.keywords for name, declared in keys_of(kind).items()}
    # Imported here: few cfgs have any.
    from scenec.compiler.kinds.generate import with_forms

    return dict(with_forms(kind.SCHEMA.get("properties", {})))


def _is_of_samples(keywords: Mapping[str, Any]) -> bool:
    """Whether a key is a number that is drawn once a sample, or a list of such."""
    below = (keywords[name] for name in ("items", "else") if name in keywords)
    return keywords.get("x-per") == "sample" or any(map(_is_of_samples, below))
