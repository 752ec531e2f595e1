"""What must hold of objects that are models: their parts, their poses.

Like ``check_names``, these checks pass over what does not have the shape they look for.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from scenec.compiler.cfg.check_files import InputFile
from scenec.compiler.cfg.faults import Finding
from scenec.schemas.errors import SceneError
from scenec.schemas.spelling import nearest, shown


def check_models(document: Any, files: Mapping[str, InputFile]) -> list[Finding]:
    """Findings on classes of meshes and of placed objects.

    Args:
        document: A cfg, perhaps with faults.
        files: Its files that nothing is wrong with, by path.
    """
    objects = document.get("objects") if isinstance(document, dict) else None
    found: list[Finding] = []
    for name, thing in (objects if isinstance(objects, dict) else {}).items():
        if isinstance(thing, dict) and thing.get("type") in ("meshes", "placed"):
            found.extend(_check_parts(name, thing, files))
            if thing["type"] == "placed":
                found.extend(_check_poses(name, thing))
            else:
                found.extend(_check_weights(name, thing))
    return found


def _list(value: Any) -> list[Any]:
    return value if isinstance(value, list) else []


def _check_parts(
    name: str, thing: Mapping[str, Any], files: Mapping[str, InputFile]
) -> Iterator[Finding]:
    """A part is named that some model has."""
    parts = thing.get("parts")
    if not isinstance(parts, dict) or not parts:
        return
    known: list[str] = []
    for i, model in enumerate(_list(thing.get("models"))):
        file = files.get(f"objects/{name}/models/{i}/file")
        if file is None or not isinstance(model, dict):
            # Some of the names are not known.
            return
        known.extend(_names(file, model))
    from scenec.compiler.assets.parts import is_of

    for part in parts:
        if not any(is_of(path, part) for path in known):
            names = list(dict.fromkeys(path.rpartition("/")[2] for path in known if path))
            yield Finding(
                ("objects", name, "parts", part),
                f"no model has a part {shown(part)}{nearest(part, names)}",
                at_key=True,
            )


def _names(file: InputFile, node: Mapping[str, Any]) -> list[str]:
    """Paths of a model's parts and names of its materials."""
    from scenec.compiler.assets.cache import cached_model

    unit_m, up, part = (node.get(key) for key in ("unit_m", "up", "part"))
    try:
        model = cached_model(file.path, unit_m, up, part)
    except (SceneError, TypeError, KeyError):
        # Told where it stands.
        return []
    return [*model.parts, *(material.name for material in model.materials)]


def _check_poses(name: str, thing: Mapping[str, Any]) -> Iterator[Finding]:
    path = ("objects", name)
    if "poses" in thing and "file" in thing:
        yield Finding(
            (*path, "file"), "poses and file both say where objects are: take one away", at_key=True
        )
    if "poses" not in thing and "file" not in thing:
        yield Finding(path, 'expected the key "poses" or the key "file"')
    models = _list(thing.get("models"))
    for i, pose in enumerate(_list(thing.get("poses"))):
        model = pose.get("model", 0) if isinstance(pose, dict) else 0
        if isinstance(model, int) and models and model >= len(models):
            yield Finding(
                (*path, "poses", i, "model"),
                f"{model}: expected an index into models, at most {len(models) - 1}",
            )


def _check_weights(name: str, thing: Mapping[str, Any]) -> Iterator[Finding]:
    models = _list(thing.get("models"))
    weights = [model.get("weight", 1) for model in models if isinstance(model, dict)]
    if weights and all(weight == 0 for weight in weights):
        yield Finding(
            ("objects", name, "models"), "no model has a weight above 0: expected one or more"
        )
