"""Finishes the materials of a build: all pictures made, as small as cameras let them be."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

from scenec.compiler.cache.memo import memoized
from scenec.compiler.materials.bake import baked
from scenec.compiler.materials.displacement import displacement_of
from scenec.compiler.materials.finer import finer_normals
from scenec.compiler.materials.footprint import Footprint
from scenec.compiler.materials.heights import AT_ONCE, forget_looks
from scenec.compiler.materials.leave_out import UnusedMap, unseen, with_factor, without_unneeded
from scenec.compiler.materials.pictures import with_pictures
from scenec.compiler.materials.plan import MapSources, MaterialPlan
from scenec.compiler.materials.reduce import halvings, mean_lean, reduced
from scenec.compiler.materials.values import Source, forget_pixels, size_of, stored
from scenec.compiler.scene.ground import Ground
from scenec.compiler.scene.material import Material
from scenec.schemas.codec import Facts
from scenec.schemas.left_out import entry
from scenec.schemas.maps import COLORS, MAP_CHANNELS
from scenec.schemas.threads import on_threads


@dataclass(frozen=True)
class MeshLimits:
    """Says how fine the ground's mesh is, for its pictures.

    Attributes:
        tolerance_px: Reached by the mesh; None: it shows no relief finer than the grid.
        finest_m: Shortest leg that is halved.
    """

    tolerance_px: float | None
    finest_m: float


@dataclass
class Finished:
    """Materials for a Scene.

    Attributes:
        materials: By name.
        facts: By name, for report.json.
        left_out: What is not written, for report.json.
    """

    materials: dict[str, Material] = field(default_factory=dict)
    facts: dict[str, Facts] = field(default_factory=dict)
    left_out: list[Facts] = field(default_factory=list)


def finish(
    materials: dict[str, MaterialPlan],
    ground: Ground,
    looked_at: dict[str, Footprint] | None,
    mesh: MeshLimits,
) -> Finished:
    """Makes pictures, and leaves out what no camera can notice.

    Args:
        materials: As drawn, and those of models.
        ground: Whose layers say which pictures of heights are needed.
        looked_at: From ``footprints``; None: there are no cameras, and all stays.
        mesh: The ground's.

    Raises:
        SceneError: A picture cannot be read any more.
    """
    out = Finished()
    heights = _with_heights(ground)

    def one_of(name: str) -> Finished:
        drawn = materials[name]
        if drawn.material.maps is None:
            return Finished({name: drawn.material})
        footprint = None if looked_at is None else looked_at[name]
        return _finished(name, drawn, name in heights, footprint, mesh)

    for one in on_threads(one_of, materials, AT_ONCE):
        out.materials |= one.materials
        out.facts |= one.facts
        out.left_out += one.left_out
    forget_looks()
    forget_pixels()
    return out


def _with_heights(ground: Ground) -> set[str]:
    """Materials whose heights blends go by: up to the last layer that has one."""
    last = max((i for i, layer in enumerate(ground.layers) if layer.height_blend > 0.0), default=-1)
    return {layer.material for layer in ground.layers[: last + 1]}


@memoized("surfaces", lambda name, **_: name)
def _finished(
    name: str, drawn: MaterialPlan, high: bool, footprint: Footprint | None, mesh: MeshLimits
) -> Finished:
    """Finishes one material, which reads nothing of the others."""
    out, material, sources = Finished(), drawn.material, drawn.sources
    facts: dict[str, Any] = {}
    as_is = footprint is None or (sources is not None and sources.as_is)
    _note_folder(name, sources, out)
    if footprint is not None and footprint.seen == 0.0 and not as_is and drawn.procedural:
        # Its numbers are the means of pictures that need not be made.
        out.left_out.append(
            _entry(name, "the procedural pictures", "no camera sees the material: its means do", 0)
        )
    else:
        material, told = with_pictures(drawn, high)
        facts |= told
    material, done = baked(material, sources)
    if done:
        facts["made"] = done
    if material.maps is not None and high and sources is not None and sources.heights is not None:
        material = _with_files(material, {**material.maps.files, "height": sources.heights})
    left: list[UnusedMap] = []
    if (footprint is None or footprint.seen > 0.0) and material.maps is not None:
        if footprint is not None:
            material = _without_mesh_relief(material, drawn, footprint, mesh, facts)
        material = _with_lean(material, facts)
        if footprint is not None and not as_is:
            material, left = without_unneeded(material)
            material = _reduced(material, footprint, facts)
    elif not as_is and material.maps is not None:
        material, left = unseen(material, material.maps)
    out.left_out += [_entry(name, f"the picture of {one.kind}", one.why, one.bytes) for one in left]
    if facts:
        out.facts[name] = facts
    kept = material.maps
    if kept is not None:
        lean = kept.lean if "normal" in kept.files else 0.0
        kept = replace(kept, lean=lean) if kept.files else None
    out.materials[name] = replace(material, maps=kept)
    return out


def _with_lean(material: Material, facts: dict[str, Any]) -> Material:
    """Measures how its normals lean, before texels go whose facets hide each other all the same."""
    maps = material.maps
    # By texture coordinates come models, whose files mean no more than they say.
    if maps is None or maps.projection == "uv" or "normal" not in maps.files:
        return material
    facts["lean"] = mean_lean(maps.files["normal"])
    return replace(material, maps=replace(maps, lean=facts["lean"]))


def _with_files(material: Material, files: dict[str, Source]) -> Material:
    assert material.maps is not None
    ordered = {kind: files[kind] for kind in MAP_CHANNELS if kind in files}
    return replace(material, maps=replace(material.maps, files=ordered))


def _note_folder(name: str, sources: MapSources | None, out: Finished) -> None:
    if sources is None:
        return
    for files, why in (
        (sources.unused, "of the folder: another file takes its place, or nothing shows it"),
        (sources.unknown, "of the folder: its name does not say what it is"),
    ):
        out.left_out += [_entry(name, file, why, None) for file in files]


def _entry(material: str, what: str, why: str, size: int | None) -> Facts:
    return entry("surfaces", f"materials/{material}: {what}", why, size=size or 0)


def _without_mesh_relief(
    material: Material,
    drawn: MaterialPlan,
    footprint: Footprint,
    mesh: MeshLimits,
    facts: dict[str, Any],
) -> Material:
    """Normals without what the mesh shows of the same relief."""
    relief = displacement_of(drawn)
    maps = material.maps
    assert maps is not None
    if relief is None or mesh.tolerance_px is None:
        return material
    spectrum = relief.spectrum()
    facts["displacement"] = {
        "octaves_m": spectrum.wavelength_m.tolist(),
        "amplitudes_m": spectrum.amplitude_m.tolist(),
    }
    if "normal" not in maps.files:
        return material
    picture, facts["normals_beside_mesh"] = finer_normals(
        maps.files["normal"],
        maps.size_m,
        footprint.seen / maps.size_m,
        mesh.tolerance_px,
        mesh.finest_m,
    )
    return _with_files(material, {**maps.files, "normal": picture})


def _reduced(material: Material, footprint: Footprint, facts: dict[str, Any]) -> Material:
    """Pictures with no more texels than pixels show."""
    assert material.maps is not None
    files: dict[str, Source] = {}
    reports: dict[str, Any] = {}
    for kind, source in material.maps.files.items():
        high, wide = stored(source).shape[:2]
        # What is cut out is what its file says, to the texel.
        times = 0 if kind == "opacity" else halvings(high, wide, footprint.counted)
        found = reduced(source, kind, times) if times else None
        files[kind] = source if found is None else found.picture
        reports[kind] = {
            "texels": [wide, high],
            "texels_per_pixel": min(high, wide) / footprint.counted,
        }
        if found is None:
            continue
        reports[kind] |= {
            "texels_kept": [wide >> times, high >> times],
            "texels_per_pixel_kept": (min(high, wide) >> times) / footprint.counted,
            "bytes_saved": size_of(source) - len(found.picture.data),
            **found.facts,
        }
        if kind in COLORS:
            material = with_factor(material, kind, found.factor)
    facts["pictures"] = reports
    assert material.maps is not None
    return replace(material, maps=replace(material.maps, files=files))
