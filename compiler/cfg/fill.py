"""A sound cfg with every default filled in."""

from __future__ import annotations

from typing import Any

from scenec.compiler.cfg.check_numbers import read_number
from scenec.compiler.kinds import schema
from scenec.compiler.kinds.schema import Field
from scenec.compiler.kinds.table import loaded
from scenec.schemas.codec import JsonObject
from scenec.schemas.imu import GRAVITY_M_S2

#: A cfg in full, by key; what it holds is said by the declarations of ``kinds.table``.
type Cfg = JsonObject


def fill(document: Any) -> Cfg:
    """The cfg in full, as nested dicts and lists.

    - Every key of the schemas is there, in their order; named things keep the file's order. Those
      with "x-sparse" are there only if they are given, so that digests of older cfgs stay.
    - A key that was left out has its default, or None where it has none.
    - Every number is a float, an int (where whole numbers are taken) or a ``Distribution``.
    - Where a default hangs on other keys, the class that declares them says it in its ``fill``.
    - A sensor without outputs has the cfg's; an IMU without gravity that of the sky's planet; a
      ground layer with a coverage has threshold None, one with conditions and without a noise has
      noise None.
    """
    cfg: Any = _fill(schema.root(document))
    for rig in cfg["rigs"].values():
        for sensor in rig["sensors"].values():
            if sensor["outputs"] is None:
                sensor["outputs"] = list(cfg["outputs"])
        for imu in rig.get("imus", {}).values():
            if imu["gravity_m_s2"] is None:
                body = (cfg["terrain"].get("planet") or {}).get("body")
                imu["gravity_m_s2"] = GRAVITY_M_S2[body or cfg["light"]["sky"]["planet"]]
    given = document["terrain"]["ground"]
    for layer, own in zip(cfg["terrain"]["ground"][1:], given[1:], strict=True):
        if layer["coverage"] is not None:
            layer["threshold"] = None
        if layer["where"] is not None and "noise" not in own:
            layer["noise"] = None
    return cfg


def _fill(field: Field) -> Any:
    value = field.value
    if field.is_number and value is not None:
        return read_number(value, field.keywords)
    if "const" in field.keywords:
        # 1.0 equals 1, but is not written alike.
        return field.keywords["const"]
    if isinstance(value, dict):
        return _fill_object(field, value)
    if isinstance(value, list):
        return [_fill_below(field, i, entry) for i, entry in enumerate(value)]
    if field.keywords.get("type") == "integer":
        return int(value)
    if field.keywords.get("type") == "number":
        return float(value) + 0.0
    return value


def _fill_object(field: Field, value: dict[str, Any]) -> dict[str, Any]:
    filled: dict[str, Any] = {}
    properties = field.keywords.get("properties", {})
    for key, below in properties.items():
        if below.get("x-ignored") or ("x-sparse" in below and key not in value):
            continue
        if key in value:
            filled[key] = _fill_below(field, key, value[key])
            continue
        # The default stands beside the reference, so it is there before any value is.
        filled[key] = _fill_below(field, key, below["default"]) if "default" in below else None
    for key, entry in value.items():
        if key not in properties:
            filled[key] = _fill_below(field, key, entry)
    if "x-fill" in field.keywords:
        loaded(field.keywords["x-fill"]).fill(filled, value)
    return filled


def _fill_below(field: Field, key: str | int, value: Any) -> Any:
    below = schema.child(field, key, value)
    assert below is not None, f"no schema for {field.path} {key}"
    return _fill(below)
