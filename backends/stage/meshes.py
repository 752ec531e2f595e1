"""Meshes of a stage as triangles, each with its labels and materials."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from pxr import Usd, UsdGeom, UsdShade

from scenec.backends.stage import values
from scenec.backends.stage.corners import MeshCorners
from scenec.backends.stage.curves import read_curves
from scenec.backends.stage.deforming import TOO_MANY, Deformations, ShapePose, is_skinned
from scenec.backends.stage.implicit import dimensions, tessellate
from scenec.backends.stage.labels import LabelTable, face_labels, prim_labels
from scenec.backends.stage.normals import read_normals, split_points
from scenec.backends.stage.scene import Mesh, Surface
from scenec.backends.stage.sources import Sources
from scenec.backends.stage.subdivided import (
    FAR,
    MeshPolygons,
    on_limit,
    read_polygons,
    refined,
)
from scenec.backends.stage.surfaces import (
    bound_material,
    bound_surface,
    display_color,
    display_opacity_threshold,
    is_absent,
    read_height_blends,
    read_layers,
    read_variation,
    shows_display_color,
)
from scenec.backends.stage.unread import Unread, all_equal
from scenec.schemas import stage as names
from scenec.schemas.errors import StageError
from scenec.schemas.polygons import triangulate
from scenec.schemas.subdivision import Refined

#: In place of a surface, of faces that are not there.
_ABSENT = -1
#: Triangles of all poses of the shapes of a stage that deform, beyond their first ones.
_MOST_POSED = 1 << 24
#: Matrices of the rows of all poses, one a sample: 400 MB.
_MOST_MATRICES = 1 << 22
#: What is said of colors that are not shown one by one.
MISFIT = "displayColor of another length than its shape needs is shown as its mean"

#: A part of a mesh, and which of the mesh's points it has.
type _Part = tuple[Mesh, slice | NDArray[np.bool_]]


@dataclass(frozen=True)
class ShapeParts:
    """Holds a shape in one of its poses.

    Attributes:
        meshes: Indices of its parts: one for each material bound to some of its faces.
        shown: At which samples it is so, bool [samples]; None: at all.
    """

    meshes: list[int]
    shown: NDArray[np.bool_] | None = None


class MeshTable:
    """Meshes and surfaces in the order in which they were first met; met again, they are shared."""

    def __init__(
        self, labels: LabelTable, times: Sequence[Usd.TimeCode], unread: Unread, sources: Sources
    ) -> None:
        self.labels = labels
        self.unread = unread
        self.surfaces: dict[Surface, int] = {}
        self._sources = sources
        self.meshes: list[Mesh] = []
        self._time = times[0]
        self._deformations = Deformations(times)
        self._room, self._matrices, self._samples = _MOST_POSED, _MOST_MATRICES, len(times)
        #: How often what is added now stands somewhere.
        self.copies = 1
        #: Of a shape that deforms: the meshes that are one part of it, pose by pose, and which of
        #: them is there at each sample, int64 [samples].
        self.families: list[tuple[tuple[int, ...], NDArray[np.int64]]] = []
        self._frame: int | None = None
        self._known: dict[tuple, list[ShapeParts]] = {}

    def frame(self) -> int:
        """Index of a mesh without faces: it says where what deforms is."""
        if self._frame is None:
            self._frame = len(self.meshes)
            none = np.zeros((0, 3), np.float32)
            labels = {level: np.zeros(0, np.uint32) for level in self.labels.levels}
            faces, weights = np.zeros((0, 3), np.int32), np.zeros((0, 0), np.float32)
            self.meshes.append(Mesh("", none, faces, None, None, labels, (), weights))
        return self._frame

    def add(self, prim: Usd.Prim, inherited: dict[str, int]) -> list[ShapeParts]:
        """Returns a shape's poses, the first sample's first.

        Args:
            prim: A UsdGeomMesh or an implicit shape, an instance proxy perhaps.
            inherited: Labels of the instancer around it.

        Raises:
            StageError: Its arrays contradict each other, or hold NaN; or a length cannot be.
        """
        source = prim.GetPrimInPrototype() if prim.IsInstanceProxy() else prim
        bound = bound_material(prim, self._sources)
        key: tuple[object, ...] = (
            source.GetPath(),
            tuple(sorted(inherited.items())),
            str(bound.GetPath()),
        )
        if prim.IsInstanceProxy():
            # Labels and colors can come from above an instance: only equal ones can share.
            labels = tuple(sorted(prim_labels(prim, self.labels).items()))
            key = (*key, labels, display_color(prim))
            if is_skinned(prim):
                # So can what moves a skeleton.
                key = (*key, str(prim.GetPath()))
        if key not in self._known:
            self.unread.shape(prim, bound)
            self.unread.material(bound)
            if not prim.IsA(UsdGeom.Mesh) and (is_absent(bound) or _is_clear(prim, bound)):
                return self._known.setdefault(key, [ShapeParts([])])
            if prim.IsA(UsdGeom.BasisCurves):
                return self._known.setdefault(key, self._curves(prim, inherited))
            if not prim.IsA(UsdGeom.Mesh):
                return self._known.setdefault(key, [ShapeParts([self._implicit(prim, inherited)])])
            self._known[key] = self._read(UsdGeom.Mesh(prim), inherited)
        return self._known[key]

    def _added(self, parts: list[_Part], poses: Iterable[ShapePose]) -> list[ShapeParts]:
        """Adds a shape's parts, pose by pose."""
        found: list[ShapeParts] = []
        for pose in poses:
            start = len(self.meshes)
            for part, own in parts:
                normals = None if pose.normals is None else pose.normals[own]
                self.meshes.append(replace(part, points=pose.points[own], normals=normals))
            found.append(ShapeParts(list(range(start, len(self.meshes))), pose.shown))
        if len(found) > 1:
            at = np.argmax([pose.shown for pose in found if pose.shown is not None], axis=0)
            meshes = zip(*(pose.meshes for pose in found), strict=True)
            self.families += [(family, at) for family in meshes]
        return found

    def _with_room(
        self, prim: Usd.Prim, poses: list[ShapePose], lost: str, triangles: int
    ) -> list[ShapePose]:
        """A shape's poses, or the first where all would be too much."""
        more = len(poses) - 1
        matrices = more * self._samples * self.copies
        if triangles * more > self._room or matrices > self._matrices:
            poses, lost = [replace(poses[0], shown=None)], TOO_MANY
        else:
            self._room -= triangles * more
            self._matrices -= matrices
        if lost:
            self.unread.add(lost, prim)
        return poses

    def _index(self, surface: Surface) -> int:
        return self.surfaces.setdefault(surface, len(self.surfaces))

    def _implicit(self, prim: Usd.Prim, inherited: dict[str, int]) -> int:
        """Index of an implicit shape's mesh: equal shapes that look alike share one."""
        shape = dimensions(prim, self._time)
        bound = bound_surface(prim, self._sources)
        surface = self._index(bound)
        labels = self._labels(prim, inherited)
        textured = self._is_textured(prim, bound)
        key = (*shape, surface, *labels.values())
        if key not in self._known:
            with np.errstate(all="ignore"):
                triangles = tessellate(shape)
            if not np.isfinite(triangles.points).all():
                raise StageError(f"{prim.GetPath()}: a {shape[0]} too large for its points")
            count = len(triangles.faces)
            self._known[key] = [ShapeParts([len(self.meshes)])]
            self.meshes.append(
                Mesh(
                    path=str(prim.GetPath()),
                    points=triangles.points,
                    faces=triangles.faces,
                    authored_face=None,
                    normals=triangles.normals,
                    labels={k: np.full(count, v, np.uint32) for k, v in labels.items()},
                    layers=(surface,),
                    weights=np.zeros((0, len(triangles.points)), np.float32),
                    uv=np.zeros((count, 3, 2), np.float32) if textured else None,
                )
            )
        return self._known[key][0].meshes[0]

    def _labels(self, prim: Usd.Prim, inherited: dict[str, int]) -> dict[str, int]:
        """Labels of a shape that is one thing."""
        none = dict.fromkeys(self.labels.levels, 0)
        return {**none, **inherited, **prim_labels(prim, self.labels)}

    def _is_textured(self, prim: Usd.Prim, surface: Surface) -> bool:
        textured = surface.maps is not None and surface.maps.projection == "uv"
        if textured:
            self.unread.add("a texture on a shape without texture coordinates is flat", prim)
        return textured

    def _curves(self, prim: Usd.Prim, inherited: dict[str, int]) -> list[ShapeParts]:
        curves = read_curves(prim, self._time)
        poses, lost = self._deformations.of(prim, ShapePose(curves.points))
        tubes = curves.tubes(poses[0].points)
        for line in curves.lines:
            self.unread.add(line, prim)
        color, bound = None, bound_material(prim, self._sources)
        primvar = UsdGeom.PrimvarsAPI(prim).FindPrimvarWithInheritance("displayColor")
        if shows_display_color(bound) and not all_equal(primvar):
            found = values.flattened(primvar, np.float32, self._time, width=(3,))
            shown = curves.at_samples(found, primvar.GetInterpolation())
            if shown is None:
                self.unread.add(MISFIT, prim)
            else:
                color = shown.astype(np.float32)[tubes.sample[tubes.faces]]
        surface = bound_surface(prim, self._sources, None if color is None else (1.0, 1.0, 1.0))
        textured = self._is_textured(prim, surface)
        labels = self._labels(prim, inherited)
        count = len(tubes.faces)
        whole = Mesh(
            path=str(prim.GetPath()),
            points=tubes.points,
            faces=tubes.faces,
            authored_face=tubes.curve,
            normals=tubes.normals,
            labels={k: np.full(count, v, np.uint32) for k, v in labels.items()},
            layers=(self._index(surface),),
            weights=np.zeros((0, len(tubes.points)), np.float32),
            uv=np.zeros((count, 3, 2), np.float32) if textured else None,
            color=color,
        )
        poses = self._with_room(prim, poses, lost, count)
        drawn = (curves.posed(pose) for pose in poses)
        return self._added([(whole, slice(None))], drawn)

    def _read(self, mesh: UsdGeom.Mesh, inherited: dict[str, int]) -> list[ShapeParts]:
        prim = mesh.GetPrim()
        time = self._time
        read = read_polygons(mesh, time)
        normals = read_normals(mesh, read, time)
        rest = ShapePose(read.points, normals.values, at=normals.at)
        poses, lost = self._deformations.of(
            prim, rest, lambda at: read_normals(mesh, read, at).values
        )
        read = replace(read, points=poses[0].points)
        layers = read_layers(mesh, len(read.points), self._sources)
        variation = read_variation(prim, len(read.points))
        surface = None
        if layers is None and variation is None:
            surface = refined(mesh, read, time)
            if surface is not None and not surface.is_close():
                self.unread.add(FAR, prim)
        drawn = read if surface is None else on_limit(surface)
        cut = triangulate(drawn.points, drawn.indices, drawn.counts, drawn.holes)
        for fault in cut.faults:
            self.unread.add(fault, prim)
        corners, authored = cut.corners.astype(np.int32), cut.polygon.astype(np.int32)
        if surface is not None:
            authored = surface.polygon[authored].astype(np.int32)
        if values.word(mesh.GetOrientationAttr(), "", time) == UsdGeom.Tokens.leftHanded:
            corners = np.ascontiguousarray(corners[:, [0, 2, 1]])
        faces = drawn.indices[corners]
        poses = self._with_room(prim, poses, lost, len(faces))
        split = None
        if surface is None:
            split = split_points(read, poses)
            if normals.lost:
                self.unread.add(normals.lost, prim)
        labels = face_labels(mesh, self.labels, inherited, len(read.counts))
        surfaces, weights = layers or ([], np.zeros((0, len(drawn.points)), np.float32))
        if layers is not None:
            indices_of_layers = tuple(self._index(each) for each in surfaces)
        else:
            # Its own once the mesh's colors are known.
            indices_of_layers = ()

        coordinates = MeshCorners(mesh, corners, faces, authored, read, surface, time)
        same = len(read.counts) == len(faces) and bool((authored == np.arange(len(faces))).all())
        point = slice(None) if split is None else split.point
        whole = Mesh(
            path=str(prim.GetPath()),
            points=drawn.points[point],
            faces=faces if split is None else split.indices[corners],
            authored_face=None if same else authored,
            normals=None,
            labels={level: ids[authored] for level, ids in labels.items()},
            layers=indices_of_layers,
            weights=weights[:, point],
            variation=None if variation is None else variation[point],
            height_blends=read_height_blends(prim, len(weights)) if layers is not None else (),
            color=coordinates.color(names.PRIMVAR_COLOR),
        )
        parts: list[_Part]
        if layers is not None:
            parts = [(replace(whole, uv=coordinates.of(surfaces)), slice(None))]
        else:
            parts = self._by_material(mesh, whole, authored, coordinates)
        if split is not None:
            return self._added(parts, (split.pose(pose) for pose in poses))
        return self._added(parts, (_posed(mesh, read, surface, pose, time) for pose in poses))

    def _by_material(
        self,
        mesh: UsdGeom.Mesh,
        source: Mesh,
        authored: NDArray[np.int32],
        coordinates: MeshCorners,
    ) -> list[_Part]:
        """Splits a mesh whose subsets are bound to several materials."""
        subsets = UsdShade.MaterialBindingAPI(mesh.GetPrim()).GetMaterialBindSubsets()
        count = int(authored.max(initial=-1)) + 1
        # Surfaces that show displayColor as it varies over the mesh.
        varied: set[int] = set()
        # Of those whose opacity is displayOpacity, the least that is shown.
        least: dict[int, float] = {}

        def index(prim: Usd.Prim) -> int:
            bound = bound_material(prim, self._sources)
            number = _ABSENT if is_absent(bound) else colored(prim, bound)
            threshold = display_opacity_threshold(bound)
            if threshold is not None:
                least[number] = threshold
            return number

        def colored(prim: Usd.Prim, bound: UsdShade.Material) -> int:
            shows = shows_display_color(bound)
            if not shows or self._display_color(coordinates) is None:
                return self._index(bound_surface(prim, self._sources))
            number = self._index(bound_surface(prim, self._sources, (1.0, 1.0, 1.0)))
            varied.add(number)
            return number

        whole = index(mesh.GetPrim())
        surface = np.full(count, whole, np.int32)
        for subset in subsets:
            if values.word(subset.GetElementTypeAttr(), "") != UsdGeom.Tokens.face:
                continue
            chosen = values.array(subset.GetIndicesAttr(), np.int64, self._time)
            chosen = chosen[(chosen >= 0) & (chosen < count)]
            surface[chosen] = index(subset.GetPrim())
            self.unread.material(bound_material(subset.GetPrim(), self._sources))
        of_triangle = surface[authored]
        opacity = coordinates.opacity() if least else None
        if opacity is not None:
            for number, threshold in least.items():
                of_triangle[(of_triangle == number) & (opacity < threshold)] = _ABSENT
        whole_mesh = bool((of_triangle != _ABSENT).all())
        used = np.unique(of_triangle[of_triangle != _ABSENT])
        known = list(self.surfaces)
        uv = {s: coordinates.of([known[s]]) for s in used.tolist()}
        shown = self._display_color(coordinates) if varied else None
        colors = {s: shown if s in varied else source.color for s in uv}
        if len(used) <= 1 and whole_mesh and whole != _ABSENT:
            parts = [replace(source, layers=(s,), uv=uv[s], color=colors[s]) for s in uv]
            return [(part, slice(None)) for part in parts or [replace(source, layers=(whole,))]]
        return [
            _part(replace(source, color=colors[s]), authored, of_triangle == s, s, uv[s])
            for s in uv
        ]

    def _display_color(self, coordinates: MeshCorners) -> NDArray[np.float32] | None:
        """DisplayColor at corners where it varies; None where it does not, or does not fit."""
        try:
            return coordinates.color("displayColor")
        except StageError:
            self.unread.add(MISFIT, coordinates.mesh.GetPrim())
            return None


def _is_clear(prim: Usd.Prim, bound: UsdShade.Material) -> bool:
    """Whether the mean displayOpacity of a shape that is no mesh is below what is shown."""
    threshold = display_opacity_threshold(bound)
    primvar = UsdGeom.PrimvarsAPI(prim).FindPrimvarWithInheritance("displayOpacity")
    if threshold is None or not primvar or not primvar.HasValue():
        return False
    found = values.array(primvar.GetAttr(), np.float64, Usd.TimeCode.EarliestTime())
    return len(found) > 0 and float(found.mean()) < threshold


def _part(
    mesh: Mesh,
    authored: NDArray[np.int32],
    chosen: NDArray[np.bool_],
    surface: int,
    uv: NDArray[np.float32] | None,
) -> _Part:
    faces = mesh.faces[chosen]
    # A renderer that writes instances out would write all parts' vertices with each part.
    own = np.zeros(len(mesh.points), bool)
    own[faces] = True
    part = replace(
        mesh,
        points=mesh.points[own],
        faces=(np.cumsum(own, dtype=np.int32) - 1)[faces],
        variation=None if mesh.variation is None else mesh.variation[own],
        weights=mesh.weights[:, own],
        authored_face=authored[chosen],
        labels={level: ids[chosen] for level, ids in mesh.labels.items()},
        layers=(surface,),
        uv=None if uv is None else uv[chosen],
        color=None if mesh.color is None else mesh.color[chosen],
    )
    return part, own


def _posed(
    mesh: UsdGeom.Mesh,
    read: MeshPolygons,
    surface: Refined | None,
    pose: ShapePose,
    time: Usd.TimeCode,
) -> ShapePose:
    """A pose of what is drawn of a mesh: of its limit surface, if it is one."""
    if surface is None:
        return pose
    if pose.points is not read.points:
        moved = replace(read, points=pose.points)
        surface = refined(mesh, moved, time, surface.levels) or surface
    limit = on_limit(surface)
    normals = limit.normals
    left = values.word(mesh.GetOrientationAttr(), "", time) == UsdGeom.Tokens.leftHanded
    if normals is not None and left:
        normals = -normals
    return ShapePose(limit.points, normals, pose.shown)
