"""The types of a cfg in full, as ``fill`` makes it and ``draw`` reads it.

The schemas are the source: ``tests/cfg/test_typed.py`` holds these types against them. What is
of one of several kinds by its ``type`` (operators, objects, poses …) is a plain dict.
"""

from __future__ import annotations

from typing import Any, NotRequired, TypedDict

from scenec.compiler.distributions.numbers import Number

#: An object with a ``type`` of its own, or one that is drawn as a whole.
type Kind = dict[str, Any]


class Mesh(TypedDict):
    """``terrain_mesh.schema.json``."""

    tolerance_px: float
    max_triangles: int
    unseen: float
    finest_m: float | None


class Terrain(TypedDict):
    """``terrain.schema.json``."""

    size_m: list[Number]
    spacing_m: Number
    relief: list[Kind]
    ground: list[Kind]
    shades: NotRequired[list[Kind]]
    mesh: Mesh
    horizon: NotRequired[Kind]


class Light(TypedDict):
    """``light.schema.json``; a sun is None where there is none, or the sky's pictures give it."""

    sun: Kind | None
    sky: Kind
    more: dict[str, Kind]
    lamps: dict[str, Kind]
    clouds: NotRequired[Kind]
    haze: Kind | None


class Sensor(TypedDict):
    """``sensor.schema.json``; of a field of view and intrinsics one is None, or both."""

    resolution: list[int]
    fov_deg: Number | None
    intrinsics: Kind | None
    lens: NotRequired[Kind]
    mount: Kind
    exposure: Kind
    imaging: NotRequired[Kind]
    effects: NotRequired[list[Kind]]
    focus: NotRequired[Kind]
    shutter: NotRequired[Kind]
    trigger: NotRequired[Kind]
    depth_camera: NotRequired[Kind]
    partner: NotRequired[str]
    outputs: list[str]


class Rig(TypedDict):
    """``rig.schema.json``."""

    pose: Kind
    sensors: dict[str, Sensor]
    lidars: NotRequired[dict[str, Kind]]
    allow_below: NotRequired[bool]


class ObjectDetail(TypedDict):
    """``object_detail.schema.json``."""

    max_triangles: int | None


class Cfg(TypedDict):
    """``cfg.schema.json``."""

    version: int
    name: str
    description: str
    batches: int
    samples: int
    outputs: list[str]
    labels: dict[str, dict[str, int]]
    terrain: Terrain
    materials: dict[str, Kind]
    objects: dict[str, Kind]
    object_detail: ObjectDetail
    light: Light
    rigs: dict[str, Rig]
