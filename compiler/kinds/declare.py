"""Declares the keys of a cfg: fields of a class are keys, and its docstring says what it is.

    @dataclass(frozen=True, kw_only=True)
    class Clusters:
        \"\"\"Clusters (Thomas 1949): parents scattered evenly, objects around them.\"\"\"

        EXAMPLE: ClassVar = {"type": "clusters", "parents": 9, "sigma_m": 7}

        parents: int | None = key(WHOLE, at_least=1, at_most=1_000_000, optional=True)
        \"\"\"Number of parents per terrain.\"\"\"

        sigma_m: float = key(LENGTH, above=0, at_most=1e9)
        \"\"\"Standard deviation of objects about a parent.\"\"\"

The string below a field describes it, as Sphinx and editors read it. A key that has neither a
default nor is optional or sparse has to be given. From such classes ``generate`` makes the JSON
Schema, which is what a cfg is held against; they themselves are imported when one is named.
"""

from __future__ import annotations

import ast
import dataclasses
import inspect
import sys
import textwrap
from collections.abc import Callable, Mapping
from typing import Any, Literal, get_args, get_origin

from scenec.schemas.plugins import GIVEN, KEY

#: Stands for a default that there is not.
NONE: Any = object()


@dataclasses.dataclass(frozen=True)
class Form:
    """Declares the values a key takes: keywords of JSON Schema, and scenec's own ("x-…").

    Attributes:
        drawn: Name of the object or the choice (``table``) of which a kind gets one in place of
            what the cfg says; "": as it stands there.
    """

    keywords: Mapping[str, Any]
    drawn: str = ""

    def but(self, **keywords: Any) -> Form:
        """Returns the same form with other keywords; an underscore stands for a hyphen."""
        own = {name.replace("_", "-"): value for name, value in keywords.items()}
        return dataclasses.replace(self, keywords={**self.keywords, **own})


_BOUNDS = {
    "above": "exclusiveMinimum",
    "at_least": "minimum",
    "below": "exclusiveMaximum",
    "at_most": "maximum",
    "unit": "x-unit",
}


def bounded(form: Form, **bounds: Any) -> Form:
    """Returns a form within bounds: above, at_least, below, at_most, unit."""
    own = {_BOUNDS[name]: bound for name, bound in bounds.items() if bound is not None}
    return dataclasses.replace(form, keywords={**form.keywords, **own})


def key(
    form: Form,
    *,
    default: Any = NONE,
    optional: bool = False,
    sparse: bool = False,
    name: str = "",
    above: float | None = None,
    at_least: float | None = None,
    at_most: float | None = None,
    below: float | None = None,
    unit: str | None = None,
) -> Any:
    """Declares a field that is a key of the cfg.

    Args:
        form: What values it takes; it may have a default.
        default: As a cfg would say it; a field without one has to be given.
        optional: Whether it may be left out, and is None then.
        sparse: Whether it may be left out, and is not there then, nor in digests.
        name: Of the key, where it can be no field's.
        above, at_least, at_most, below: Bounds of all that it can be.
        unit: Of what is given.
    """
    form = bounded(form, above=above, at_least=at_least, at_most=at_most, below=below, unit=unit)
    more = {} if default is NONE else {"default": default}
    if sparse:
        more["x-sparse"] = True
    form = dataclasses.replace(form, keywords={**form.keywords, **more})
    needed = not (optional or sparse or "default" in form.keywords)
    usual: dict[str, Any] = {} if needed else {"default": _filled(form.keywords)}
    if isinstance(usual.get("default"), dict):
        usual = {"default_factory": usual["default"].copy}
    return dataclasses.field(metadata={KEY: Key(name, form, needed)}, **usual)


def _filled(keywords: Mapping[str, Any]) -> Any:
    """Returns a default as a cfg in full has it: real numbers are floats, lists tuples."""
    value = keywords.get("default")
    if isinstance(value, list):
        each = keywords.get("items", {})
        return tuple(_filled({**each, "default": entry}) for entry in value)
    is_real = "number" in keywords.get("type", ()) or (
        keywords.get("$ref") == "#/$defs/number" and keywords.get("x-kind") != "integer"
    )
    return float(value) if is_real and isinstance(value, int) else value


@dataclasses.dataclass(frozen=True)
class Key:
    """Declares the key of a field; without a name it is the field's."""

    name: str
    form: Form
    is_required: bool


def given(make: Callable[[Any], Any]) -> Any:
    """Declares a field that no cfg says: it is made of the context (``context.Context``).

    It is given by name. It stands last where it is called ``key``, which then is no function there.
    """
    return dataclasses.field(metadata={GIVEN: make}, kw_only=True)


def noise_key() -> Any:
    """Declares a field that is a key for hash noises, of the place where the kind stands."""
    return given(lambda context: context.key())


def values_from_context(kind: type[Any], context: Any, values: Mapping[str, Any]) -> dict[str, Any]:
    """Returns the values of a class's fields that no cfg says.

    Args:
        kind: A dataclass; another package's says by the names of its fields what it wants.
        context: See ``context.Context``.
        values: Of the keys.
    """
    fields = dataclasses.fields(kind)
    found = {f.name: f.metadata[GIVEN](context) for f in fields if GIVEN in f.metadata}
    if "key" in (f.name for f in fields) and "key" not in {**values, **found}:
        found["key"] = context.key()
    return found


def keys_of(kind: type[Any]) -> dict[str, Key]:
    """Returns what a class declares of its keys, by field, those that it derives included."""
    fields = dataclasses.fields(kind)
    return {field.name: field.metadata[KEY] for field in fields if KEY in field.metadata}


def declared_keys(kind: type[Any]) -> dict[str, tuple[dict[str, Any], bool]]:
    """Returns the schema of each key that a class declares, and whether it is required.

    Keys of classes that it derives from come first, unless they have a definition of their own
    (``SHARED``).
    """
    keys: dict[str, tuple[dict[str, Any], bool]] = {}
    for of in reversed(kind.__mro__):
        if dataclasses.is_dataclass(of) and (of is kind or "SHARED" not in vars(of)):
            keys |= _declared(of)
    return keys


def _declared(kind: type[Any]) -> dict[str, tuple[dict[str, Any], bool]]:
    texts, found = descriptions(kind), {}
    fields = {field.name: field for field in dataclasses.fields(kind)}
    # In their own order, also of a field that was there before.
    for name in kind.__annotations__:
        if name in fields and KEY in fields[name].metadata:
            field = fields[name]
            declared: Key = field.metadata[KEY]
            keywords = {**declared.form.keywords}
            if field.name in texts:
                keywords["description"] = texts[field.name]
            if keywords.get("enum") == "of annotation":
                keywords["enum"] = _listed(field.type, kind)
            found[declared.name or field.name] = keywords, declared.is_required
    return found


def _listed(annotation: Any, kind: type[Any]) -> list[Any]:
    """Returns the values that an annotation lists: ``Literal["near", "far"] | None``."""
    if isinstance(annotation, str):
        annotation = eval(annotation, vars(sys.modules[kind.__module__]))  # noqa: S307
    if get_origin(annotation) is Literal:
        return list(get_args(annotation))
    return [value for part in get_args(annotation) for value in _listed(part, kind)]


def description(kind: type[Any]) -> str:
    """Returns what a class says of itself, but for its notes to who reads the code, in a line."""
    text = inspect.cleandoc(kind.__doc__ or "").partition("\n\nNote:")[0]
    # A dataclass without a docstring has its signature there.
    return "" if text.startswith(f"{kind.__name__}(") else " ".join(text.split())


def descriptions(kind: type[Any]) -> dict[str, str]:
    """Returns what a class says of each field: the string that stands below it."""
    try:
        source = inspect.getsource(kind)
    except OSError:
        # Of a package that comes without its source.
        return {}
    tree = ast.parse(textwrap.dedent(source)).body[0]
    assert isinstance(tree, ast.ClassDef)
    found = {}
    for field, below in zip(tree.body, tree.body[1:], strict=False):
        is_text = isinstance(below, ast.Expr) and isinstance(below.value, ast.Constant)
        if is_text and isinstance(field, ast.AnnAssign) and isinstance(field.target, ast.Name):
            found[field.target.id] = " ".join(str(below.value.value).split())  # type: ignore[attr-defined]
    return found
