"""Checks of a stage: what public validators know, and what they miss.

UsdValidation (30 validators) and usd-validation-nvidia check schemas, composition and topology.
None of them looks at prototype indices, the lengths of instancers' arrays and primvars, duplicate
ids, or NaN: the checks here do. Each is a function over one prim, with a sentence that says what it
holds against it.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from pxr import Sdf, Tf, Usd, UsdGeom, UsdRender, UsdShade, UsdValidation

from scenec.backends.check.finding import Finding
from scenec.backends.stage import values as reading
from scenec.backends.stage.cameras import intrinsics_from_apertures
from scenec.backends.stage.labels import LabelTable, read_table
from scenec.backends.stage.sky_labels import load_label_map
from scenec.backends.stage.sources import Sources
from scenec.schemas import materialx
from scenec.schemas import stage as names
from scenec.schemas.errors import StageError

#: Largest difference between K from a camera's apertures and the authoritative one, pixels.
INTRINSICS_TOLERANCE_PX = 1e-3

#: Least and greatest value of the numbers on a Material.
_SURFACE_RANGES = {
    names.ATTR_BASE_COLOR: (0.0, 1.0),
    names.ATTR_SPECULAR: (0.0, 1.0),
    names.ATTR_ROUGHNESS: (0.0, 1.0),
    names.ATTR_METALLIC: (0.0, 1.0),
    names.ATTR_COLOR_VARIATION: (0.0, 1.0),
    names.ATTR_ROUGHNESS_VARIATION: (-1.0, 1.0),
    names.ATTR_DIFFUSE_TRANSMISSION: (0.0, 1.0),
    names.ATTR_PHASE_B: (0.0, 1.0),
    names.ATTR_PHASE_C: (-1.0, 1.0),
    names.ATTR_OPPOSITION: (0.0, np.inf),
    names.ATTR_OPPOSITION_WIDTH: (0.0, np.inf),
    names.ATTR_MEAN_SLOPE: (0.0, 90.0),
}

#: Errors of UsdValidation about a stage that is not whole.
NOT_WHOLE = ("CompositionError", "UnresolvableDependency")

#: Modules that Omniverse finds in its own library: what they say is read from the prim.
_MDL = "info:mdl:sourceAsset"
#: What UsdValidation, which knows nothing of MDL, says of them.
_OF_MDL = re.compile(
    r"sourceType 'mdl' .* not found in sdrRegistry|unresolvable external dependency '[^']*\.mdl'"
)

Rule = Callable[[Usd.Prim, LabelTable], Iterator[str]]


def check_stage(path: Path) -> list[Finding]:
    """All findings on one stage, none twice."""
    try:
        # What of it is missing is the reader's to say, and the manifest's.
        with Sources(path, allow_missing=True).reading() as stage:
            return _findings(stage, path)
    except StageError as error:
        return [Finding("opens", "error", path.name, str(error))]


def _findings(stage: Usd.Stage, path: Path) -> list[Finding]:
    findings = [
        Finding(check, "error", path.name, message)
        for check, message in [
            *(("layout", message) for message in _layout(stage)),
            *(("assets", message) for message in _assets(stage)),
        ]
    ]
    try:
        table = read_table(stage)
    except StageError as error:
        findings.append(Finding("labels", "error", path.name, str(error)))
        table = LabelTable({})
    for prim in Usd.PrimRange(stage.GetPseudoRoot(), Usd.TraverseInstanceProxies()):
        for name, kind, rule in _RULES:
            if prim.IsA(kind):
                findings.extend(
                    Finding(name, "error", str(prim.GetPath()), message)
                    for message in _messages(rule(prim, table))
                )
    findings.extend(_sky_labels(stage, table))
    findings.extend(_instance_ids(stage))
    findings.extend(_usd_validation(stage))
    return findings


def _messages(messages: Iterator[str]) -> Iterator[str]:
    """A rule's messages; a value that is none it can judge is one, too."""
    try:
        yield from messages
    except StageError as error:
        yield str(error)


def _layout(stage: Usd.Stage) -> Iterator[str]:
    """Meters, Z up, a default prim with our schema version: what our own stages promise."""
    root = stage.GetDefaultPrim()
    if not root:
        yield "has no defaultPrim"
        return
    version = root.GetAttribute(names.ATTR_SCHEMA_VERSION)
    if not version or not version.HasValue():
        # A foreign stage is free in its units.
        return
    if UsdGeom.GetStageMetersPerUnit(stage) != 1.0:
        yield f"metersPerUnit is {UsdGeom.GetStageMetersPerUnit(stage):g}, expected 1"
    if UsdGeom.GetStageUpAxis(stage) != UsdGeom.Tokens.z:
        yield f"upAxis is {UsdGeom.GetStageUpAxis(stage)}, expected Z"


def _assets(stage: Usd.Stage) -> Iterator[str]:
    """Every layer and picture is found, by a relative path."""
    for prim in stage.TraverseAll():
        for attribute in prim.GetAuthoredAttributes():
            if str(attribute.GetTypeName()) != "asset":
                continue
            times = attribute.GetTimeSamples() or [Usd.TimeCode.Default()]
            for asset in {attribute.Get(time) for time in times}:
                if asset is None or not asset.path:
                    continue
                if Path(asset.path).is_absolute():
                    yield f"{attribute.GetPath()} is the absolute path {asset.path}"
                if not asset.resolvedPath and attribute.GetName() != _MDL:
                    yield f"{attribute.GetPath()}: {asset.path} does not exist"
    for layer in stage.GetUsedLayers():
        for sublayer in layer.subLayerPaths:
            if Path(sublayer).is_absolute():
                yield f"{Path(layer.realPath).name} names the absolute path {sublayer}"
            elif not (Path(layer.realPath).parent / sublayer).is_file():
                yield f"{Path(layer.realPath).name}: sublayer {sublayer} does not exist"


def _mesh_topology(prim: Usd.Prim, table: LabelTable) -> Iterator[str]:
    """Finite points; counts and indices that fit them."""
    mesh = UsdGeom.Mesh(prim)
    points = _numbers(mesh.GetPointsAttr(), 3)
    counts = _numbers(mesh.GetFaceVertexCountsAttr())
    indices = _numbers(mesh.GetFaceVertexIndicesAttr())
    if not np.isfinite(points).all():
        yield f"{int((~np.isfinite(points)).any(axis=1).sum())} points are not finite"
    if counts.size and counts.min() < 3:
        yield f"{int((counts < 3).sum())} faces have fewer than three vertices"
    if counts.sum() != indices.size:
        yield f"faceVertexCounts add up to {int(counts.sum())}, there are {indices.size} indices"
    if indices.size and (indices.min() < 0 or indices.max() >= len(points)):
        yield (
            f"faceVertexIndices go from {int(indices.min())} to {int(indices.max())}, there are "
            f"{len(points)} points"
        )


def _mesh_labels(prim: Usd.Prim, table: LabelTable) -> Iterator[str]:
    """Label primvars have one value a face, and each value is in the table."""
    api = UsdGeom.PrimvarsAPI(prim)
    faces = len(_numbers(UsdGeom.Mesh(prim).GetFaceVertexCountsAttr()))
    for level, ids in table.ids.items():
        primvar = api.FindPrimvarWithInheritance(names.label_primvar(level))
        if not primvar or not primvar.HasValue():
            continue
        values = reading.flattened(primvar, np.int64, reading.DEFAULT)
        expected = 1 if primvar.GetInterpolation() == UsdGeom.Tokens.constant else faces
        if values.size != expected:
            yield f"primvar {primvar.GetPrimvarName()} has {values.size} values for {faces} faces"
        unknown = sorted(set(np.unique(values).tolist()) - {0, *ids.values()})
        if unknown:
            yield f"primvar {primvar.GetPrimvarName()} has ids {unknown[:5]} that the table lacks"


def _vertex_primvars(prim: Usd.Prim, table: LabelTable) -> Iterator[str]:
    """Scenec's vertex primvars have one finite value a point; there is a weight for each merge."""
    count = len(_numbers(UsdGeom.Mesh(prim).GetPointsAttr(), 3))
    wanted = [
        names.weight_primvar(i) for i in range(1, len(reading.targets(prim, names.REL_LAYERS)))
    ]
    api = UsdGeom.PrimvarsAPI(prim)
    if api.HasPrimvar(names.PRIMVAR_VARIATION):
        wanted.append(names.PRIMVAR_VARIATION)
    for name in wanted:
        values = _primvar(api, name)
        low = -1.0 if name == names.PRIMVAR_VARIATION else 0.0
        if values.size != count:
            yield f"primvar {name} has {values.size} values for {count} points"
        if not np.isfinite(values).all():
            yield f"primvar {name} holds values that are not finite"
        elif values.size and (values.min() < low or values.max() > 1.0):
            yield f"primvar {name} leaves [{low:g}, 1]"


def _instancer_arrays(prim: Usd.Prim, table: LabelTable) -> Iterator[str]:
    """Arrays of one length, finite; indices that name a prototype; turns that are rotations."""
    instancer = UsdGeom.PointInstancer(prim)
    indices = _numbers(instancer.GetProtoIndicesAttr())
    targets = reading.targets(prim, "prototypes")
    if indices.size and (indices.min() < 0 or indices.max() >= len(targets)):
        yield (
            f"protoIndices go from {int(indices.min())} to {int(indices.max())}, there are "
            f"{len(targets)} prototypes"
        )
    for target in targets:
        if not prim.GetStage().GetPrimAtPath(target):
            yield f"prototype {target} does not exist"
    arrays = {
        "positions": (instancer.GetPositionsAttr(), 3),
        "orientations": (instancer.GetOrientationsAttr(), 4),
        "orientationsf": (instancer.GetOrientationsfAttr(), 4),
        "scales": (instancer.GetScalesAttr(), 3),
        "velocities": (instancer.GetVelocitiesAttr(), 3),
    }
    for name, (attribute, width) in arrays.items():
        values = _numbers(attribute, width)
        if (attribute.HasAuthoredValue() or name == "positions") and len(values) != indices.size:
            yield f"{indices.size} protoIndices, but {len(values)} {name}"
        if not np.isfinite(values).all():
            yield f"{int((~np.isfinite(values)).any(axis=1).sum())} {name} are not finite"
        elif width == 4 and len(values) and (np.abs(values).max(axis=1) == 0).any():
            yield f"{name} hold zero quaternions"
    api = UsdGeom.PrimvarsAPI(prim)
    for primvar in api.GetPrimvarsWithAuthoredValues():
        if primvar.GetInterpolation() == UsdGeom.Tokens.vertex:
            values = primvar.ComputeFlattened()
            if values is None or len(values) != indices.size:
                yield (
                    f"primvar {primvar.GetPrimvarName()} has {len(values or ())} values for "
                    f"{indices.size} instances"
                )


def _instancer_ids(prim: Usd.Prim, table: LabelTable) -> Iterator[str]:
    """Ids are there, one an instance, none twice, none below 1."""
    instancer = UsdGeom.PointInstancer(prim)
    ids = reading.array(instancer.GetIdsAttr(), np.int64, Usd.TimeCode.EarliestTime())
    count = len(_numbers(instancer.GetProtoIndicesAttr()))
    if not ids.size:
        enabled = reading.flag(prim.GetAttribute(names.ATTR_INSTANCE_IDS_ENABLED), True)
        if count and enabled and prim.HasAttribute(names.ATTR_INSTANCE_ID_BASE):
            yield "has no ids"
        return
    if ids.size != count:
        yield f"{count} protoIndices, but {ids.size} ids"
    unique, uses = np.unique(ids, return_counts=True)
    if (uses > 1).any():
        yield f"ids {unique[uses > 1][:5].tolist()} stand more than once"
    if prim.HasAttribute(names.ATTR_INSTANCE_ID_BASE) and unique[0] < 1:
        yield f"the lowest id is {unique[0]}, expected 1 or more"


def _camera(prim: Usd.Prim, table: LabelTable) -> Iterator[str]:
    """K from focal length and apertures agrees with the authoritative one."""
    attribute = prim.GetAttribute(names.ATTR_INTRINSICS)
    near, far = reading.vector(UsdGeom.Camera(prim).GetClippingRangeAttr(), 2) or (1.0, 1e6)
    if not 0.0 < near < far:
        yield f"clippingRange ({near:g}, {far:g}) is not 0 < near < far"
    if not attribute or not attribute.HasValue():
        return
    stated, size = reading.vector(attribute, 9), _resolution_of(prim)
    if stated is None or size is None:
        return
    derived = intrinsics_from_apertures(prim, size, Usd.TimeCode.EarliestTime())
    exact = np.array(stated).reshape(3, 3)
    # Skew has no place in a UsdGeomCamera.
    error = np.abs(derived - exact)[[0, 1, 0, 1], [0, 1, 2, 2]].max()
    if not error <= INTRINSICS_TOLERANCE_PX:
        yield (
            f"focal length and apertures differ from {names.ATTR_INTRINSICS} by {error:.3g} pixels"
        )


def _surface(prim: Usd.Prim, table: LabelTable) -> Iterator[str]:
    """The numbers of our surface model are finite and in their ranges."""
    for name, (low, high) in _SURFACE_RANGES.items():
        attribute = prim.GetAttribute(name)
        count = 3 if name == names.ATTR_BASE_COLOR else 1
        values = np.array(_some(attribute, count))
        if not np.isfinite(values).all() or (values < low).any() or (values > high).any():
            told = ", ".join(f"{value:g}" for value in values)
            yield f"{name} is {told}, expected {low:g} to {high:g}"


def _resolution_of(camera: Usd.Prim) -> tuple[int, int] | None:
    for prim in camera.GetStage().Traverse():
        if prim.IsA(UsdRender.Product):
            product = UsdRender.Product(prim)
            if camera.GetPath() in reading.targets(prim, "camera"):
                size = reading.vector(product.GetResolutionAttr(), 2)
                return None if size is None else (int(size[0]), int(size[1]))
    return None


def _materialx(prim: Usd.Prim, table: LabelTable) -> Iterator[str]:
    """Inputs and outputs of our MaterialX nodes are those of their kind, connected to the like."""
    if not _is_our_materialx(prim):
        # A foreign node may take what ours never do.
        return
    shader = UsdShade.Shader(prim)
    kind = materialx.NODES[shader.GetShaderId()]
    for plug in shader.GetInputs():
        expected = kind.inputs.get(plug.GetBaseName())
        if expected is None:
            yield f"{shader.GetShaderId()} has no input {plug.GetBaseName()}"
        elif str(plug.GetTypeName()) != expected:
            yield f"input {plug.GetBaseName()} is {plug.GetTypeName()}, expected {expected}"
        for attribute in plug.GetValueProducingAttributes():
            if attribute.GetTypeName() != plug.GetTypeName():
                yield f"input {plug.GetBaseName()} takes {attribute.GetPath()}, of another type"
        if not plug.GetValueProducingAttributes():
            yield f"input {plug.GetBaseName()} has neither a value nor a source"
    for output in shader.GetOutputs():
        if (output.GetBaseName(), str(output.GetTypeName())) != (materialx.OUTPUT, kind.output):
            yield f"{shader.GetShaderId()} has no output {output.GetBaseName()} of that type"


_RULES: tuple[tuple[str, Any, Rule], ...] = (
    ("mesh-topology", UsdGeom.Mesh, _mesh_topology),
    ("mesh-labels", UsdGeom.Mesh, _mesh_labels),
    ("mesh-primvars", UsdGeom.Mesh, _vertex_primvars),
    ("instancer-arrays", UsdGeom.PointInstancer, _instancer_arrays),
    ("instancer-ids", UsdGeom.PointInstancer, _instancer_ids),
    ("camera", UsdGeom.Camera, _camera),
    ("surface", UsdShade.Material, _surface),
    ("materialx", UsdShade.Shader, _materialx),
)


def _sky_labels(stage: Usd.Stage, table: LabelTable) -> Iterator[Finding]:
    """Label maps of the Sky prim are pictures of one channel, with ids that the table knows."""
    prim = stage.GetPrimAtPath(names.SKY_PRIM)
    pictures: dict[tuple[str, Path], None] = {}
    for level in table.levels if prim else ():
        attribute = prim.GetAttribute(names.ATTR_SKY_LABEL_MAP.format(level=level))
        if not attribute:
            continue
        for time in attribute.GetTimeSamples() or [Usd.TimeCode.Default()]:
            asset = attribute.Get(time)
            # One that is not there is another check's.
            if isinstance(asset, Sdf.AssetPath) and asset.resolvedPath:
                pictures[level, Path(asset.resolvedPath)] = None
    for level, file in pictures:
        try:
            ids = set(np.unique(load_label_map(file)).tolist())
        except StageError as error:
            yield Finding("sky-labels", "error", str(prim.GetPath()), str(error))
            continue
        unknown = sorted(ids - {0, *table.ids[level].values()})
        if unknown:
            message = f"{file.name} has ids {unknown[:5]} that the level {level} lacks"
            yield Finding("sky-labels", "error", str(prim.GetPath()), message)


def _instance_ids(stage: Usd.Stage) -> Iterator[Finding]:
    """Single objects of a class have ids of their own, from 1; those of classes do not overlap."""
    try:
        ranges = []
        for prim in stage.TraverseAll():
            base = prim.GetAttribute(names.ATTR_INSTANCE_ID_BASE)
            if not base or not base.HasValue():
                continue
            path = str(prim.GetPath())
            if prim.IsA(UsdGeom.PointInstancer):
                ids = _numbers(UsdGeom.PointInstancer(prim).GetIdsAttr())
            else:
                local = [p.GetAttribute(names.ATTR_LOCAL_INSTANCE_ID) for p in Usd.PrimRange(prim)]
                found = [reading.whole(a, 0) for a in local if a and a.HasAuthoredValue()]
                ids = np.array(found, np.int64)
                for message in _repeated_ids(ids):
                    yield Finding("instance-ids", "error", path, message)
            if ids.size:
                start = reading.whole(base, 0)
                ranges.append((int(start + ids.min()), int(start + ids.max()), path))
        ranges.sort()
        for (_, end, path), (start, _, other) in pairwise(ranges):
            if start <= end:
                message = f"its frame ids begin at {start}, but those of {path} go up to {end}"
                yield Finding("instance-ids", "error", other, message)
    except StageError as error:
        yield Finding("instance-ids", "error", "stage", str(error))


def _repeated_ids(ids: np.ndarray) -> Iterator[str]:
    unique, uses = np.unique(ids, return_counts=True)
    if (uses > 1).any():
        yield f"local ids {unique[uses > 1][:5].tolist()} stand more than once"
    if unique.size and unique[0] < 1:
        yield f"the lowest local id is {unique[0]}, expected 1 or more"


def _usd_validation(stage: Usd.Stage) -> Iterator[Finding]:
    registry = UsdValidation.ValidationRegistry()
    context = UsdValidation.ValidationContext(registry.GetOrLoadAllValidators())
    with Tf.DiagnosticTrap() as trap:
        # What it finds it returns, and prints besides.
        found = context.Validate(stage)
        trap.Clear()
    for error in found:
        prims = [
            site.GetProperty().GetPrim() if site.IsProperty() else site.GetPrim()
            for site in error.GetSites()
            if site.IsProperty() or site.IsPrim()
        ]
        if error.GetName() == "MissingShaderIdInRegistry" and prims and _is_our_materialx(prims[0]):
            continue
        if _OF_MDL.search(" ".join(error.GetMessage().split())):
            continue
        severe = error.GetType() == UsdValidation.ValidationErrorType.Error
        yield Finding(
            f"UsdValidation:{error.GetName()}",
            "error" if severe else "warning",
            str(prims[0].GetPath()) if prims else "stage",
            " ".join(error.GetMessage().split()),
        )


def _is_our_materialx(prim: Usd.Prim) -> bool:
    """Whether a shader is a node that the compiler writes, in a layer where it writes them.

    usd-core has no MaterialX library and so takes every such node for unknown. This is all that is
    allowed: a misspelled node, or one in another layer, stays an error. ``_materialx`` checks what
    can be checked without the library.
    """
    if UsdShade.Shader(prim).GetShaderId() not in materialx.NODES:
        return False
    authored = prim.GetAttribute("info:id").GetPropertyStack(Usd.TimeCode.Default())
    return bool(authored) and authored[0].layer.identifier.endswith(materialx.LAYER_SUFFIX)


def _primvar(api: UsdGeom.PrimvarsAPI, name: str) -> np.ndarray:
    primvar = api.GetPrimvar(name)
    if not primvar or not primvar.HasValue():
        return np.zeros(0)
    return reading.flattened(primvar, np.float64, reading.DEFAULT)


def _numbers(attribute: Usd.Attribute, width: int | None = None) -> np.ndarray:
    """An array attribute at the first time, as float64; empty where it is not authored."""
    shape = () if width is None else (width,)
    first = Usd.TimeCode.EarliestTime()
    return reading.array(attribute, np.float64, first, width=shape, finite=False)


def _some(attribute: Usd.Attribute, count: int) -> tuple[float, ...]:
    """A number, or a vector of some; () where it is not authored."""
    if reading.value_of(attribute) is None:
        return ()
    if count == 1:
        return (reading.number(attribute, 0.0, finite=False),)
    return reading.vector(attribute, count, finite=False) or ()
