"""From a cfg of OAISYS to one of ours."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from scenec.importers.assets import Assets
from scenec.importers.oaisys import listing, render
from scenec.importers.oaisys.context import DEAD, Context, Labels
from scenec.importers.oaisys.ground import added_ground, terrain_material
from scenec.importers.oaisys.light import light
from scenec.importers.oaisys.meshes import scattered
from scenec.importers.oaisys.relief import landscape, object_stage
from scenec.importers.oaisys.sensors import sensors
from scenec.importers.output import Imported
from scenec.importers.scene import identifier
from scenec.importers.source import Item, Source, check

#: Keys that nothing in OAISYS reads.
_DEAD = {
    **dict.fromkeys(
        ("defaultCfg", "saveConfigFiles", "renderDepthActive", "baseMovement",
         "positionOffsetEnabled", "targetObjectActive", "tragetObjectMovementType",
         "triggerInterval", "cameraFocalLength", "cameraFOVHorizontal", "cameraFOVVertical",
         "cameraSensorWidth", "cameraPrinciplePointU", "cameraPrinciplePointV", "stereoBaseLine",
         "SunStrength", "rgbIDVec", "instanceIDVec", "imageTileX", "imageTileY",
         "randomTargetEulerMin", "randomTargetEulerMax"),
        DEAD,
    ),
    "onlineMode": "poses from another program at run time: take a track",
}  # fmt: skip


def import_oaisys(
    file: Path, out: Path, *, folders: Sequence[Path] = (), stand_ins: bool = False
) -> Imported:
    """Translates a cfg of OAISYS.

    Args:
        file: Of the generation of 2021, of today's, or of the form of the paper's listings.
        out: The cfg that it becomes.
        folders: Where the files that it names are looked for first.
        stand_ins: Whether something procedural takes the place of files that are missing.

    Raises:
        CfgError: All that is wrong with it; or else all files that are missing.
    """
    source = Source(file)
    root = source.root()
    as_listing = listing.is_listing(root)
    current = not as_listing and _is_current(root)
    imported = Imported(out)
    count = listing.levels(root) if as_listing else render.levels(root)
    assets = Assets(file, folders, stand_ins)
    ctx = Context(imported, assets, current, Labels(count), sources=[source])
    form = "the paper's listings" if as_listing else "today" if current else "2021"
    imported.cfg.update(
        version=1,
        name=identifier(file.stem),
        description=f"Imported from {file.name}, a cfg of OAISYS ({form})",
        batches=1,
        samples=1,
        outputs=[],
        labels={},
        terrain={},
        materials={},
        objects={},
    )
    if as_listing:
        listing.translate(ctx, root)
    else:
        _translate(ctx, root)
    for read in ctx.sources:
        read.leave(_DEAD)
    check(ctx.sources)
    assets.check()
    imported.cfg["labels"] = ctx.labels.finish()
    if not imported.cfg["labels"]:
        for outputs in (imported.cfg, *imported.cfg["rigs"]["base"]["sensors"].values()):
            if "label" in outputs.get("outputs", ()):
                outputs["outputs"].remove("label")
    for read in ctx.sources:
        read.report_to(imported.report)
    return imported


def _is_current(root: Item) -> bool:
    """Whether a cfg is of today's generation: by the marks that tell it from that of 2021."""
    distance = root.object("SENSOR_SETUP").object("GENERAL").get("hoverBaseDistance")
    is_marked = root.object("SIMULATION_SETUP").get("saveMetaData")
    return bool(is_marked) or isinstance(distance.value, list)


def _translate(ctx: Context, root: Item) -> None:
    assets = root.need("ASSET_SETUP")
    render.simulation(ctx, root.need("SIMULATION_SETUP"))
    render.passes(ctx, root.need("RENDER_SETUP"))
    _materials(ctx, assets, _stage(ctx, assets))
    for entry in assets.get("MESHES").children():
        kind = entry.need("type")
        if kind.one_of("MeshMultipleRandom", "MeshAsteroid") == "MeshAsteroid":
            kind.dropped("an asteroid is no terrain: place its mesh by a class of type placed")
            continue
        kind.translated("objects")
        scattered(ctx, entry)
    light(ctx, root.need("ENVIRONMENT_EFFECTS_SETUP"))
    sensors(ctx, root.need("SENSOR_SETUP"))
    render.effects(ctx, root.get("RENDER_POST_PROCESSING_EFFECTS_SETUP"))


def _stage(ctx: Context, assets: Item) -> str | None:
    """The relief of the first stage; the name of its material."""
    stages = assets.need("STAGES")
    entries = stages.children()
    for other in entries[1:]:
        other.dropped("a batch has one terrain: the first stage")
    if not entries:
        stages.fault("no stage: expected a list of one or more")
        return None
    kind, params = entries[0].need("type"), entries[0].need("stageParams")
    entries[0].get("name").translated("terrain")
    if kind.one_of("StageBlenderLandscape", "StageBlenderObject") == "StageBlenderLandscape":
        landscape(ctx, params)
        unused = ["stageFilePath", "meshInstanceName", "particleSystems", "stageDisplacementActive"]
    else:
        object_stage(ctx, params)
        unused = ["stageLandscapePreset", "landscapeParams", "stageSizeX"]
    kind.translated("terrain/relief")
    params.drop(f"says nothing in a {kind.value}", *unused)
    params.drop("a name alone", "stageName")
    material = params.get("assetMaterial").translated("terrain/ground")
    return material.text() if material else None


def _materials(ctx: Context, assets: Item, used: str | None) -> None:
    materials = assets.get("MATERIALS")
    entries = materials.children()
    names = [entry.value.get("name") for entry in entries if isinstance(entry.value, dict)]
    taken = 0 if used is None else names.index(used) if used in names else None
    if taken is None:
        materials.fault(f"no material is called {used!r}, which the stage has; known: {names}")
    for i, entry in enumerate(entries):
        if i != taken:
            entry.dropped("the stage has another material")
            continue
        kind = entry.need("type")
        entry.get("name").translated("terrain/ground")
        if kind.one_of("MaterialTerrain", "MaterialAsteroid") == "MaterialAsteroid":
            kind.dropped("materials of asteroids have no counterpart: bare regolith")
            continue
        kind.translated("terrain/ground")
        terrain_material(ctx, entry.need("materialParams"))
    if "ground" not in ctx.cfg["terrain"]:
        added_ground(ctx, "the stage has no material that could be translated")
