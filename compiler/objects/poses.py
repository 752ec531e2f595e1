"""Declares single objects at given poses, and draws them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.arithmetic import elementary
from scenec.compiler.assets.pose_table import PoseTable, read_poses
from scenec.compiler.assets.tables import GEOGRAPHIC, PLACE
from scenec.compiler.geometry.places import on_plane
from scenec.compiler.kinds import Context, Finding, Node, an, bounded, file, key, list_of
from scenec.compiler.kinds.forms import CHOICE, COUNT, LENGTH_PER_BATCH, PER_BATCH, TRUTH
from scenec.compiler.objects.models import (
    MATERIAL,
    MODELS,
    PARTS,
    check_parts,
    draw_models,
    draw_rules,
)
from scenec.schemas.codec import JsonObject
from scenec.schemas.quaternions import quaternion_product

if TYPE_CHECKING:
    from scenec.compiler.objects.placed import PlacedPlan

_ANGLE = bounded(PER_BATCH, at_least=-360, at_most=360, unit="deg")


@dataclass(frozen=True, kw_only=True)
class ObjectPose:
    """Where one object is."""

    EXAMPLE: ClassVar = {"x_m": 0, "y_m": 4, "rotation_deg": [0, 0, 30]}

    TITLE: ClassVar = "Pose of an object"
    x_m: float = key(LENGTH_PER_BATCH, sparse=True, at_least=-1000000000.0, at_most=1000000000.0)
    """East. Given with y_m, or else latitude_deg with longitude_deg."""
    y_m: float = key(LENGTH_PER_BATCH, sparse=True, at_least=-1000000000.0, at_most=1000000000.0)
    """North."""
    latitude_deg: float = key(PER_BATCH, sparse=True, at_least=-90, at_most=90, unit="deg")
    """Geodetic latitude, on a georeferenced DEM."""
    longitude_deg: float = key(PER_BATCH, sparse=True, at_least=-360, at_most=360, unit="deg")
    """Longitude, to the east."""
    z_m: float = key(LENGTH_PER_BATCH, default=0, at_least=-1000000000.0, at_most=1000000000.0)
    """Height of the object's origin, see heights."""
    rotation_deg: Any = key(
        list_of(_ANGLE, "About one axis.", count=3), default=[0, 0, 0], unit="deg"
    )
    """Turns about the world's x, y and z, in that order; z counterclockwise from above."""
    scale: float = key(PER_BATCH, default=1, above=0, at_most=1_000_000)
    """Factor on its size."""
    model: int = key(COUNT, default=0, at_least=0, at_most=999)
    """Which of the models: its index, from 0."""

    @staticmethod
    def check(node: Node) -> Iterator[Finding]:
        """Yields a place in two ways, in none, or by latitude where no DEM has one."""
        for metric, geographic in zip(PLACE[:2], GEOGRAPHIC[:2], strict=True):
            yield from node.either(metric, geographic, "where the object is")
        if (GEOGRAPHIC[0] in node) != (GEOGRAPHIC[1] in node):
            yield node.fault("expected latitude_deg and longitude_deg, or x_m and y_m")
        dems = [o["type"] for o in node.whole().each("terrain", "relief", "*")]
        if GEOGRAPHIC[0] in node and "dem" not in dems:
            yield node.key_fault(
                "the terrain lies nowhere on a body: expected x_m and y_m, or a DEM whose file has "
                "a georeference",
                GEOGRAPHIC[0],
            )


@dataclass(frozen=True, kw_only=True)
class PlacedKeys:
    """Single objects at given poses, which may move: a lander, a calibration board."""

    EXAMPLE: ClassVar = {
        "type": "placed",
        "models": [{"file": "lander.glb"}],
        "labels": {"class": "lander"},
        "poses": [{"x_m": 0, "y_m": 4}],
        "orientation": "normal",
    }

    models: tuple[JsonObject, ...] = key(MODELS)
    material: str | None = key(MATERIAL, optional=True)
    parts: JsonObject = key(PARTS, default={})
    labels: JsonObject = key(an("label_choice"), default={})
    """The objects' label on every level."""
    instances: bool = key(TRUTH, default=True)
    """Whether each object has an instance id."""
    poses: tuple[JsonObject, ...] | None = key(
        list_of(an("object_pose"), "One object.", least=1, most=100000), optional=True
    )
    """Where the objects are, one entry each; or give file."""
    file: Path | None = key(file("poses"), optional=True)
    """CSV of poses, relative to the cfg. Columns: x_m, y_m, or latitude_deg, longitude_deg on a
    georeferenced DEM; z_m (else 0); qw, qx, qy, qz (else unturned); scale (else 1); model (index,
    else 0); id (local instance id, from 1); time_s. Rows of one id are one moving object; without
    id, rows with time_s are one object, rows without are copies."""
    heights: Literal["ground", "world"] = key(CHOICE, default="ground")
    """What heights are over: the ground below the object's origin, or the world's zero."""
    orientation: Literal["upright", "normal"] = key(CHOICE, default="upright")
    """upright: as the pose says; normal: then tilted with the ground under it."""

    check_files = staticmethod(check_parts)

    @staticmethod
    def check(node: Node) -> Iterator[Finding]:
        """Yields findings between its keys."""
        yield from node.both("poses", "file", "where objects are")
        if "poses" not in node and "file" not in node:
            yield node.fault('expected the key "poses" or the key "file"')
        count = len(node.at("models").entries)
        for pose in node.each("poses", "*"):
            if count and pose["model"] is not None and pose["model"] >= count:
                yield pose.fault(
                    f"{pose['model']}: expected an index into models, at most {count - 1}", "model"
                )

    def draw(self, context: Context) -> PlacedPlan:
        """Returns what is drawn of the class.

        Raises:
            SceneError: The file of poses cannot be read.
        """
        # Imported here: cfgs are checked without.
        from scenec.compiler.objects.placed import PlacedPlan, PoseKeys

        what = context.path
        if self.file is not None:
            poses, what = read_poses(self.file, len(self.models)), f"{what}: {self.file.name}"
        else:
            poses = _listed(self.poses or (), context)
        if poses.is_geographic:
            position = on_plane(poses.position_m, context.georeference(), what)
            poses = replace(poses, position_m=position)
        ids, first = np.unique(poses.id, return_index=True)
        columns = poses.time_s, poses.position_m, poses.quaternion, poses.scale
        bounds = [*first.tolist(), len(poses.id)]
        return PlacedPlan(
            name=context.path.rpartition("/")[2],
            material=self.material,
            labels=context.label_ids(self.labels),
            instances=self.instances,
            models=draw_models(self.models, context),
            rules=draw_rules(self.parts, context),
            model=poses.model[first].astype(np.int32),
            ids=ids,
            keys=tuple(PoseKeys(*(own[a:b] for own in columns)) for a, b in pairwise(bounds)),
            on_ground=self.heights == "ground",
            along_normal=self.orientation == "normal",
            variation=0.0,
        )


def _listed(nodes: Sequence[JsonObject], context: Context) -> PoseTable:
    count = len(nodes)
    position = np.array([[node[key] for key in _place(node)] for node in nodes])
    for n in np.flatnonzero([GEOGRAPHIC[0] in node for node in nodes]).tolist():
        what = f"{context.path}/poses/{n}"
        position[n] = on_plane(position[n : n + 1], context.georeference(), what)[0]
    return PoseTable(
        id=np.arange(1, count + 1),
        time_s=np.zeros(count),
        position_m=position,
        quaternion=np.array([quaternion_of(node["rotation_deg"]) for node in nodes]),
        scale=np.array([float(node["scale"]) for node in nodes]),
        model=np.array([node["model"] for node in nodes], np.int64),
    )


def _place(node: JsonObject) -> tuple[str, ...]:
    return GEOGRAPHIC if GEOGRAPHIC[0] in node else PLACE


def quaternion_of(degrees: Sequence[float]) -> NDArray[np.float64]:
    """Turns about x, y, z in turn (fixed axes) as a unit quaternion (w, x, y, z), [4]."""
    out = np.array([1.0, 0.0, 0.0, 0.0])
    for axis, angle in enumerate(degrees):
        half = 0.5 * angle * elementary.PI / 180.0
        s = elementary.sin(half)
        turn = np.array([elementary.cos(half), 0.0, 0.0, 0.0])
        turn[1 + axis] = s
        out = np.array(quaternion_product(turn, out))
    return out
