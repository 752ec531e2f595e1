"""Writes cfgs in Python: a class for each object of the schemas, with its keys as fields.

``ReliefMultifractal(amplitude_m=Uniform(min=1, max=2), scale_m=20)`` is
``{"type": "multifractal", "amplitude_m": {"type": "uniform", "min": 1, "max": 2}, "scale_m": 20}``.
The schemas are the one source: classes are made of them when they are first asked for, and
``builder.pyi``, for editors and type checkers, is written out of them (``tools/cfg_stub.py``).

A class is named as its definition in the schema is, a distribution as its type is. A field that
is not given is a key that is left out; None is JSON's null.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from scenec.compiler.kinds import schema
from scenec.schemas.codec import Facts, JsonObject
from scenec.schemas.errors import CfgError
from scenec.schemas.spelling import nearest, shown

if TYPE_CHECKING:
    from scenec.compiler.cfg.load import Spec

#: Of a field that is not given.
LEFT_OUT: Any = type("LeftOut", (), {"__repr__": lambda _: "…", "__bool__": lambda _: False})()


class Part:
    """An object of a cfg."""

    #: The key ``type`` (or ``version``) and its one value, where there is one.
    _CONST: tuple[tuple[str, Any], ...] = ()

    def __setattr__(self, name: str, value: Any) -> None:
        """Sets a key.

        Raises:
            AttributeError: There is none of this name.
        """
        known = self.__dataclass_fields__  # type: ignore[attr-defined]
        if name not in known:
            kind = type(self).__name__
            raise AttributeError(f"{kind} has no key {shown(name)}{nearest(name, known)}")
        super().__setattr__(name, value)

    def as_json(self) -> Facts:
        """Returns its value in a cfg: the keys that are given, in the schema's order."""
        given = ((name, getattr(self, name)) for name in self.__dataclass_fields__)  # type: ignore[attr-defined]
        kept = {name: _plain(value) for name, value in given if value is not LEFT_OUT}
        return dict(self._CONST) | kept

    def __repr__(self) -> str:
        """Without what is left out."""
        given = (f"{key}={getattr(self, key)!r}" for key in self.as_json() if hasattr(self, key))
        return f"{type(self).__name__}({', '.join(given)})"


class CompleteCfg(Part):
    """Writes and validates a complete cfg."""

    def text(self) -> str:
        """Returns the text of a JSON file."""
        return json.dumps(self.as_json(), indent=2, ensure_ascii=False) + "\n"

    def save(self, path: Path | str) -> Path:
        """Write it to a file; returns its path."""
        path = Path(path)
        path.write_text(self.text(), encoding="utf-8")
        return path

    def check(self, folder: Path | str = ".") -> Spec:
        """Validate it.

        Args:
            folder: Which files that it names are relative to.

        Raises:
            CfgError: With all of its faults, each with its JSON pointer.
        """
        # Imported here: it takes longer than all of this module.
        from scenec.compiler.cfg.load import load

        path = Path(folder) / "cfg"
        try:
            return load(path, text=self.text().encode())
        except CfgError as error:
            raise error.unplaced(str(path)) from None


def read(path: Path | str) -> Any:
    """The ``Cfg`` of a file that nothing is wrong with.

    Raises:
        CfgError: It has faults.
    """
    from scenec.compiler.cfg.load import load

    return _parsed({"$ref": schema.ROOT}, json.loads(load(path).text))


def __getattr__(name: str) -> Any:
    if name == "__all__":
        # What the cfg has, and what reads and marks it: not what this module imports.
        return ["LEFT_OUT", "CompleteCfg", "Part", "read", *names()]
    if name not in names():
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return part_class(names()[name])


def __dir__() -> list[str]:
    return __getattr__("__all__")  # type: ignore[no-any-return]


@cache
def names() -> Mapping[str, str]:
    """Classes that there are: name -> the reference to its schema."""
    references: dict[str, str] = {}
    for file, content in schema.load_schemas().items():
        if file == schema.NUMBER:
            references |= {
                _camel(kind): f"{schema.NUMBER}/$defs/{kind}" for kind in content["$defs"]
            }
        elif "properties" in content and "allOf" not in content and not content.get("x-shared"):
            references[_camel(file.rpartition("/")[2])] = file
    return references


def keys(reference: str) -> Facts:
    """The schema of each key of an object; of keys that have one value, ``const`` says it."""
    properties = schema.describe({"$ref": reference}, {}).keywords["properties"]
    return {key: entry for key, entry in properties.items() if not entry.get("x-ignored")}


@cache
def part_class(reference: str) -> type[Part]:
    """The class of a schema."""
    name = next(name for name, own in names().items() if own == reference)
    described = schema.describe({"$ref": reference}, {})
    const = {
        key: entry["const"]
        for key, entry in keys(reference).items()
        if "const" in entry and not entry.get("x-sparse")
    }
    required = described.keywords.get("required", ())
    fields = [
        (key, Any) if key in required else (key, Any, dataclasses.field(default=LEFT_OUT))
        for key in keys(reference)
        if "const" not in keys(reference)[key]
    ]
    base = CompleteCfg if reference == schema.ROOT else Part
    namespace = {
        "__doc__": described.keywords.get("description"),
        "_CONST": tuple(const.items()),
        "__module__": __name__,
    }
    return dataclasses.make_dataclass(
        name, fields, bases=(base,), kw_only=True, repr=False, namespace=namespace
    )


def _camel(name: str) -> str:
    return "".join(word.capitalize() for word in name.split("_"))


def _plain(value: Any) -> Any:
    if isinstance(value, Part):
        return value.as_json()
    if isinstance(value, Mapping):
        return {key: _plain(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(entry) for entry in value]
    # NumPy's numbers and arrays.
    return value.tolist() if hasattr(value, "tolist") else value


def _parsed(of: Any, value: Any) -> Any:
    """A sound value of a schema, its objects as parts."""
    if isinstance(value, list):
        kinds = schema.describe(of, value).keywords
        each = [*kinds.get("prefixItems", ()), *[kinds.get("items")] * len(value)]
        return [_parsed(kind, one) for kind, one in zip(each, value, strict=False)]
    if not isinstance(value, dict):
        return value
    reference = _reference(of, value)
    if reference is None:
        keywords = schema.describe(of, value).keywords
        own, rest = keywords.get("properties", {}), keywords.get("additionalProperties")
        return {key: _parsed(own.get(key, rest), one) for key, one in value.items()}
    known = keys(reference)
    given = {k: v for k, v in value.items() if k in known and "const" not in known[k]}
    given = {k: _parsed(known[k], v) for k, v in given.items()}
    return part_class(reference)(**given)


def _reference(of: JsonObject, value: JsonObject) -> str | None:
    """The schema of an object that has a class; None for one that maps names."""
    reference = of.get("$ref")
    if reference == schema.NUMBER or schema.describe(of, value).is_number:
        return f"{schema.NUMBER}/$defs/{value['type']}"
    if reference in names().values():
        return str(reference)
    content = schema.load_schemas()[reference] if reference else of
    for branch in content.get("allOf", ()):
        if schema.fits(value, branch["if"]):
            return str(branch["then"]["$ref"])
    return None
