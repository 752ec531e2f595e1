"""``SIMULATION_SETUP``, ``RENDER_SETUP`` and the effects after rendering."""

from __future__ import annotations

from typing import Any

from scenec.importers.numbers import tidy
from scenec.importers.oaisys.context import Context
from scenec.importers.source import Item

#: Keys that OAISYS' program reads and ours has no place for.
_SIMULATION = {
    "outputIDOffset": "batches are numbered from 0; export --format oaisys has its own numbers",
    "outputPath": "-o of scenec run says it",
    "saveBlenderFiles": "each batch is a USD stage, which Blender opens",
    "saveMetaData": "each frame has a sidecar, each output a manifest",
}
_GENERAL = {
    "renderFeatureSet": "the mesh is subdivided when it is compiled",
    "performanceTilesX": "the renderer's own affair",
    "performanceTilesY": "the renderer's own affair",
}
_ENGINES = ("CYCLES", "BLENDER_EEVEE", "BLENDER_EEVEE_NEXT", "BLENDER_WORKBENCH")
#: Output of each pass; with "depth", all outputs in the order in which a cfg names them.
PASSES = {"RGBDPass": "rgb", "SemanticPass": "label", "InstancePass": "instance"}


def ordered(outputs: list[str]) -> list[str]:
    """Outputs in the order of the schema, each once; a picture where there would be none."""
    return [name for name in (*PASSES.values(), "depth") if name in outputs] or ["rgb"]


def counts(ctx: Context, setup: Item) -> None:
    """Translates the numbers of batches and samples."""
    for key, ours in (("numBatches", "batches"), ("numSamplesPerBatch", "samples")):
        ctx.cfg[ours] = setup.need(key).translated(ours).whole(1, 1_000_000)


def simulation(ctx: Context, setup: Item) -> None:
    """``SIMULATION_SETUP``."""
    counts(ctx, setup)
    for key, why in _SIMULATION.items():
        setup.drop(why, key)
    rendered = setup.get("renderImages")
    if rendered and not rendered.flag():
        rendered.translated("scenec compile", "stages alone")
    else:
        rendered.translated("scenec run")


def levels(setup: Item) -> int:
    """Levels of labels that are rendered; faults are those of ``passes``."""
    for entry in setup.object("RENDER_SETUP").need("RENDER_PASSES").children():
        if entry.get("type").value == "SemanticPass":
            return entry.object("passParams").get("numIter").whole(0, 1000, 1)
    return 0


def passes(ctx: Context, setup: Item) -> None:
    """Outputs, and the options of a renderer."""
    general = setup.object("GENERAL")
    engine, device = general.get("renderEngine"), general.get("renderDevice")
    if engine:
        is_cycles = engine.one_of(*_ENGINES) == "CYCLES"
        backend = "cycles" if is_cycles else "pyrender"
        ctx.imported.options += ["--backend", backend]
        note = "" if is_cycles else "the other rasterizer"
        engine.approximated(f"scenec run --backend {backend}", note)
    name = {"GPU": "cuda", "CPU": "cpu"}[device.one_of("GPU", "CPU")]
    device.approximated(f"scenec run --device {name}", "left out, it is the fastest that works")
    for key, why in _GENERAL.items():
        general.drop(why, key)
    outputs: list[str] = []
    for entry in setup.need("RENDER_PASSES").children():
        _pass(ctx, entry, outputs)
    ctx.cfg["outputs"] = ordered(outputs)


def _pass(ctx: Context, entry: Item, outputs: list[str]) -> None:
    kind = entry.need("type")
    name = kind.one_of(*PASSES)
    kind.translated(f"outputs: {PASSES[name]}")
    params = entry.object("passParams")
    number = params.get("numIter").translated("labels" if name == "SemanticPass" else "outputs")
    if number.whole(0, 1000, 1):
        outputs.append(PASSES[name])
    params.drop("OAISYS reads it nowhere: DepthEnabled of a sensor counts", "renderDepthActive")
    spp = params.get("renderSamples")
    if name != "RGBDPass":
        params.drop(
            "annotation is exact: it takes no samples", "renderSamples", "lightPathesMaxBounces"
        )
        return
    if spp:
        ctx.imported.options += ["--spp", str(spp.whole(1, 2**20))]
        spp.translated(f"scenec run --spp {spp.value}")
    why = "renderers have their own number of bounces, the same in all of them"
    params.drop(why, "lightPathesMaxBounces")


def effects(ctx: Context, setup: Item) -> None:
    """``RENDER_POST_PROCESSING_EFFECTS_SETUP``: bloom, after the rig is there."""
    setup.object("GENERAL").drop("only the picture has effects", "renderPasses")
    for entry in setup.get("POST_EFFECTS").children():
        kind = entry.need("type")
        if kind.one_of("BloomEffect", "CombineEffect") != "BloomEffect":
            kind.dropped("no effect of this kind")
            continue
        named = next((k for k in ("postEffectsParams", "effectParams") if entry.get(k)), "")
        _bloom(ctx, kind, entry.object(named) if named else entry)


#: Electrons that a pixel of this size holds, as the cfg has it where nothing is said.
_WELL_E, _PIXEL_UM = 10500.0, 3.45
#: A sensor that adds nothing of its own to a picture.
_CLEAN: dict[str, Any] = {
    "shot_noise": False, "read_noise_e": 0, "prnu": 0, "dsnu_e": 0, "mosaic": "none",
    "dark_current": {"rate_e_s": 0}, "defects": {"hot": 0, "dead": 0}, "headroom_stops": 4,
}  # fmt: skip


def _of_focus(sensor: dict[str, Any]) -> dict[str, Any]:
    """Returns a sensor's focus settings, removed from its own optics."""
    focus = sensor.get("focus")
    if focus is None:
        return {}
    pixel_um = 1e3 * focus.pop("focal_length_mm") / sensor["intrinsics"]["fx"]
    # As many electrons on each bit of its area as those of the usual pixel.
    well = min(_WELL_E * (pixel_um / _PIXEL_UM) ** 2, 1e9)
    return {
        "f_number": focus.pop("f_number"),
        "pixel_um": tidy(pixel_um),
        "full_well_e": tidy(round(well)),
    }


def _bloom(ctx: Context, kind: Item, params: Item) -> None:
    to = "rigs/base/sensors/*/imaging/bloom"
    kind.approximated(to, "light that the lens scatters, without a threshold")
    size = params.get("size").approximated(
        f"{to}/radius_px", "three Gaussians as wide as the glare"
    )
    mix = params.get("mix").approximated(f"{to}/share", "a share of the light; its sum stays")
    # Blender's glare reaches over 2^size pixels; -1 is the picture alone, 1 the glare alone.
    radius = 2.0 ** size.number(1.0, 9.0, 6.0) / 9.0
    share = 0.04 * (1.0 + mix.number(-1.0, 1.0, 0.0))
    for sensor in ctx.cfg["rigs"]["base"]["sensors"].values():
        sensor["imaging"] = {
            **_CLEAN,
            **_of_focus(sensor),
            "bloom": {"share": tidy(share), "radius_px": tidy(max(radius, 0.5))},
        }
    params.drop("it is always as fine as the picture", "quality")
    params.drop("bright and dark light is scattered alike", "threshold")
