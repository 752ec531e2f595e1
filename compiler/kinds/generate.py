"""Makes the JSON Schema of a cfg (draft 2020-12) out of what ``table`` and the kinds declare."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from scenec.compiler.kinds import forms, shared
from scenec.compiler.kinds.declare import Form, declared_keys, description
from scenec.compiler.kinds.forms import DEFS
from scenec.compiler.kinds.laws import LAWS
from scenec.compiler.kinds.shared import Keys
from scenec.compiler.kinds.table import CHOICES, CLASSES, KindChoice, class_of
from scenec.schemas.codec import JsonObject
from scenec.schemas.plugins import plugin_name

#: Forms by the names that other packages' schemas call them by.
FORMS = {name.lower(): form for name, form in vars(forms).items() if isinstance(form, Form)}
#: How other packages' schemas refer to objects.
_FILE = ".schema.json"
_DRAFT = "https://json-schema.org/draft/2020-12/schema"


#: Of each law of numbers, where it is drawn.
_NUMBER = {
    "title": "Number",
    "description": "A constant, or a distribution. Bounds of a key hold for all that a "
    "distribution can give.",
    "type": ["number", "object"],
    "if": {"type": "object"},
}


def bundle() -> JsonObject:
    """Returns the schema of a whole cfg, with one definition for each object and each kind."""
    names = sorted([*CLASSES, *CHOICES, "number"])
    return {
        "$schema": _DRAFT,
        "title": "scenec cfg",
        "description": description(class_of("cfg")),
        "$ref": f"{DEFS}cfg",
        "$defs": {name: definition(name) for name in names},
    }


def definition(name: str) -> JsonObject:
    """Returns the definition of an object, of a kind in its context, or of a choice of kinds."""
    if name == "number":
        return _number()
    return _choice(CHOICES[name]) if name in CHOICES else _object(name)


def _number() -> dict[str, Any]:
    """Returns the definition of a constant or one of the laws that it is drawn from."""
    kind = {"description": "Kind of distribution."}
    per: Keys = {"per": (dict(forms.PER.keywords), False)}
    laws = {
        name: {
            "description": description(law),
            "examples": [vars(law)["EXAMPLE"]],
            **_keys({"type": ({**kind, "const": name}, True)}, law, per),
        }
        for name, law in LAWS.items()
    }
    then = {
        "required": ["type"],
        "properties": {"type": {**kind, "enum": list(LAWS)}},
        "allOf": _branches({name: f"number/$defs/{name}" for name in LAWS}),
    }
    return {**_NUMBER, "then": then, "$defs": laws}


def _keys(first: Keys, kind: type[Any], last: Keys | None = None) -> dict[str, Any]:
    """Returns an object's type and keys: a class's own ones, those before and those after."""
    own = declared_keys(kind)
    later = {name: said for name, said in (last or {}).items() if name not in own}
    keys = {**first, **own, **later}
    required = [key for key, (_, needed) in keys.items() if needed]
    return {
        "type": "object",
        **({"required": required} if required else {}),
        **({"properties": {key: keywords for key, (keywords, _) in keys.items()}} if keys else {}),
        "additionalProperties": False,
    }


def _branches(kinds: Mapping[str, str], usual: str = "") -> list[dict[str, Any]]:
    """Returns what leads from a ``type`` to its definition; the usual one's may be missing."""
    return [
        {
            "if": {
                "properties": {"type": {"const": kind}},
                # Of null, where that is allowed, `required` holds.
                **({} if kind == usual else {"required": ["type"]}),
                **({"type": "object"} if usual and kind != usual else {}),
            },
            "then": {"$ref": f"{DEFS}{name}"},
        }
        for kind, name in kinds.items()
    ]


def _choice(choice: KindChoice) -> dict[str, Any]:
    """Returns what stands for one of several kinds, by ``type``."""
    kinds: dict[str, Any] = {"enum": list(choice.kinds)}
    if choice.group:
        kinds["x-open"] = choice.group
    schema: dict[str, Any] = {
        "title": choice.title,
        "description": choice.description,
        "type": "object",
        **({"x-kinds": "type"} if choice.group else {}),
        **({} if choice.usual else {"required": ["type"]}),
        "properties": {"type": {"description": choice.of, **kinds}},
        **choice.keywords,
    }
    if not choice.kinds:
        return {**schema, "additionalProperties": False}
    return {**schema, "allOf": _branches(choice.kinds, choice.usual)}


def _object(name: str) -> dict[str, Any]:
    """Returns the definition of what a class declares."""
    kind, own = class_of(name), vars(class_of(name))
    changes = dict(own.get("VARIANTS", {}).get(name, {}))
    first: Keys = {}
    last: Keys = {}
    context = next((c for c in CHOICES.values() if name in c.kinds.values()), None)
    if context is not None:
        of = next(type_ for type_, other in context.kinds.items() if other == name)
        is_usual = of == context.usual
        said = {"description": context.each or context.of, "const": of}
        # Digests of cfgs that do not say it stay.
        first["type"] = said | ({"x-sparse": True} if is_usual else {}), not is_usual
        last = _shared(context, kind)
    says = changes.get("DESCRIPTION") or description(kind)
    if context is not None and context.says:
        says += " " + context.says.format(kind)
    example = changes.get("EXAMPLE", own.get("EXAMPLE"))
    found = {
        "title": changes.get("TITLE") or own.get("TITLE") or _title(name, context),
        "description": says,
        **({} if example is None else {"examples": [example]}),
        **_keys(first, kind, last),
        **_check(CLASSES[name] if hasattr(kind, "check") else context.check if context else ""),
        **({"x-fill": CLASSES[name]} if "fill" in own else {}),
    }
    for key, change in changes.items():
        if key in found["properties"]:
            found["properties"][key] = {**found["properties"][key], **change}
    above = next((vars(base) for base in kind.__mro__[1:] if "SHARED" in vars(base)), None)
    if above is not None or "SHARED" in own:
        del found["additionalProperties"]
    if above is not None:
        found |= {"$ref": f"{DEFS}{above['SHARED']}", "unevaluatedProperties": False}
    elif "SHARED" in own:
        found["x-shared"] = True
    return {**found, **changes.get("KEYWORDS", own.get("KEYWORDS", {}))}


def _check(place: str) -> dict[str, Any]:
    """Returns the keyword that says whose check holds."""
    return {"x-check": place} if place else {}


def _shared(choice: KindChoice, kind: type[Any]) -> Keys:
    """Returns the keys that a kind has as all of its choice have."""
    return getattr(shared, choice.shared)(kind) if choice.shared else {}


def _title(name: str, context: KindChoice | None) -> str:
    """Returns what an object is called on the reference page where it says nothing else."""
    if context is not None:
        of = next(type_ for type_, other in context.kinds.items() if other == name)
        return f"{context.prefix or context.title}: {of.replace('_', ' ')}"
    first, _, rest = name.partition("_")
    return first.capitalize() + (f": {rest.replace('_', ' ')}" if rest else "")


def foreign(group: str, kind: type[Any]) -> JsonObject:
    """Returns what another package's kind says of its keys, and those that its group shares."""
    choice = next((choice for choice in CHOICES.values() if choice.group == group), None)
    common = {} if choice is None else _shared(choice, kind)
    check: dict[str, Any] = _check(choice.check if choice else "")
    if not hasattr(kind, "SCHEMA"):
        if hasattr(kind, "check"):
            check["x-offered"] = [group, plugin_name(group, kind)]
        return {"description": description(kind), **_keys({}, kind, common), **check}
    keys = dict(kind.SCHEMA.get("properties", {}))
    keys |= {name: keywords for name, (keywords, _) in common.items()}
    return {**kind.SCHEMA, "properties": keys, "additionalProperties": False, **check}


def with_forms(schema: Any) -> Any:
    """Returns a schema of another package with the forms that it refers to by name."""
    if isinstance(schema, list):
        return [with_forms(entry) for entry in schema]
    if not isinstance(schema, dict):
        return schema
    file, _, name = str(schema.get("$ref", "")).partition("#/$defs/")
    if file == "forms.schema.json":
        # What stands beside the reference goes before the form.
        own = {key: entry for key, entry in schema.items() if key != "$ref"}
        return {**FORMS[name].keywords, **with_forms(own)}
    found = {key: with_forms(entry) for key, entry in schema.items()}
    if file.endswith(_FILE):
        found["$ref"] = DEFS + file.removesuffix(_FILE) + (f"/$defs/{name}" if name else "")
    return found
