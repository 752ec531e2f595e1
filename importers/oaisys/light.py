"""``ENVIRONMENT_EFFECTS_SETUP``: sun, sky and panoramas."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from scenec.importers.numbers import mean, scaled, uniform
from scenec.importers.oaisys.context import Context, label_vector
from scenec.importers.report import ADDED
from scenec.importers.scene import identifier
from scenec.importers.source import Item

#: Solar irradiance above the atmosphere, W/m².
_SOLAR = 1361.0
_SUN, _SKY = "light/sun", "light/sky"
_DEAD = "OAISYS reads it nowhere"


def light(ctx: Context, setup: Item) -> None:
    """The light; of several effects, the first."""
    general = setup.object("GENERAL")
    strength = general.get("backgroundStrength")
    ends = strength.span(0.0, 1e6) if strength else (1.0, 1.0)
    effects = setup.need("ENVIRONMENT_EFFECTS").children()
    for other in effects[1:]:
        other.dropped("a scene has one sky: the first")
    if not effects:
        if strength:
            strength.dropped("there is no effect that it is the strength of")
        added_light(ctx, "the cfg has no light")
        return
    first = effects[0]
    params = first.need("environmentEffectsParams")
    kind = first.need("type")
    is_sky = kind.one_of("EnvLightBlenderSky", "EnvHDRI") == "EnvLightBlenderSky"
    kind.translated(_SKY)
    per = _per(ctx, params)
    if is_sky:
        _sky(ctx, params, per)
        _strength(ctx, strength, ends, per)
    else:
        _panoramas(ctx, params, ends, per)
        if strength:
            strength.translated(f"{_SKY}/strength")
    for item in (general.get("stepInterval"), first.get("stepInterval")):
        if item:
            item.dropped("the interval that counts stands in environmentEffectsParams")


def _strength(ctx: Context, item: Item | None, ends: tuple[float, float], per: str) -> None:
    if item is None:
        return
    if ends[0] == ends[1] or not mean(ends):
        item.dropped("light has its physical strength, and exposure follows it")
        return
    sun = ctx.cfg["light"]["sun"]
    sun["irradiance"] = scaled(ends, _SOLAR / mean(ends), per=per)
    item.approximated(f"{_SUN}/irradiance", "as a factor whose mean is 1: exposure follows light")


def _per(ctx: Context, params: Item) -> str:
    """How often light is drawn: "" is once a sample."""
    option, step = params.get("stepIntervalOption"), params.get("stepInterval")
    interval = step.whole(1) if step else 1
    if option:
        option.one_of("GLOBAL", "LOCAL")
        option.translated("light")
    if interval == 1:
        if step:
            step.translated("light", "drawn once a sample")
        return ""
    if step and interval >= ctx.samples:
        step.translated("light", "drawn once a batch")
        return "batch"
    if step:
        step.approximated("light", "drawn once a sample")
    return ""


def _sky(ctx: Context, params: Item, per: str) -> None:
    sun: dict[str, Any] = {}
    sky: dict[str, Any] = {"type": "atmosphere", "planet": "earth"}
    ctx.cfg["light"] = {"sun": sun, "sky": sky}
    for key, owner, ours, low, high, usual, note in (
        ("SunSize", sun, "diameter_deg", 0.0, 90.0, (0.545, 0.545), ""),
        ("SunElevation", sun, "elevation_deg", -90.0, 90.0, (15.0, 90.0), ""),
        ("SunRotation", sun, "azimuth_deg", -1e5, 1e5, (0.0, 360.0), ""),
        ("SunAltitude", sky, "altitude_m", 0.0, 60000.0, (3000.0, 3350.0), ""),
        ("AirDensity", sky, "air_density", 0.0, 10.0, (1.0, 2.0), ""),
        ("DustDensity", sky, "dust_density", 0.0, 10.0, (0.0, 10.0), ""),
        ("OzoneDensity", sky, "ozone_density", 0.0, 10.0, (0.0, 5.0), ""),
    ):
        item = params.get(key)
        owner[ours] = uniform(*(item.span(low, high) if item else usual), per=per)
        if item:
            item.translated(f"{_SUN if owner is sun else _SKY}/{ours}", note)
    intensity = params.get("SunIntensity")
    if intensity:
        ends = intensity.span(1e-6, 1e6)
        if ends != (1.0, 1.0):
            sun["irradiance"] = scaled(ends, _SOLAR, per=per)
            intensity.approximated(f"{_SUN}/irradiance", "the sky follows the sun")
        else:
            intensity.translated(f"{_SUN}/irradiance")
    strength = params.get("SunStrength")
    if strength:
        strength.dropped(_DEAD)
    sky["labels"] = _pass_labels(ctx, params)


def _pass_labels(ctx: Context, params: Item) -> dict[str, str]:
    passes = params.object("passParams")
    for name, key in (("RGBDPass", "rgbIDVec"), ("InstancePass", "instanceIDVec")):
        dead = passes.object(name).get(key)
        if dead:
            dead.dropped(_DEAD)
    vector = passes.object("SemanticPass").get("semanticIDVec")
    if vector is None:
        return ctx.labels.choice([], "sky")
    return label_vector(ctx, vector, "sky", f"{_SKY}/labels")


#: How the next panorama is chosen, by ``selectionOption``.
_PICKS = {0: "in_turn", 1: "random", 2: "shuffled"}


def _panoramas(ctx: Context, params: Item, factor: tuple[float, float], per: str) -> None:
    option = params.get("selectionOption")
    number = option.whole(0, 2) if option else 2
    entries = params.need("HDRIList").children()
    files: list[str] = []
    maps: list[dict[str, Any] | None] = []
    strengths: list[tuple[float, float]] = []
    labels: dict[str, str] = {}
    for entry in entries:
        item = entry.need("filePath")
        file = ctx.assets.find(item, "a sky of the Earth")
        strength, vector = entry.get("strength"), entry.get("labelIDVec")
        ends = strength.span(1e-9, 1e6) if strength else (1.0, 1.0)
        if file is None:
            for other in (strength, vector):
                if other:
                    other.dropped("its picture is not there")
            continue
        if file.suffix.lower() not in (".exr", ".png", ".jpg", ".jpeg", ".tif", ".tiff"):
            item.fault(f"{file.name}: expected a panorama as OpenEXR; convert it (oiiotool, GIMP)")
        files.append(ctx.imported.refer(file))
        strengths.append(ends)
        item.translated(f"{_SKY}/files/{len(files) - 1}")
        base, of = _picture_labels(ctx, vector)
        labels = labels or base
        maps.append(of)
        if strength:
            strength.translated(f"{_SKY}/strength")
    if option:
        option.translated(f"{_SKY}/pick", _PICKS[number])
    _pass_labels_unused(params)
    if not files:
        added_light(ctx, "no panorama is there")
        return
    ends = (min(a for a, _ in strengths), max(b for _, b in strengths))
    sky: dict[str, Any] = {"type": "image", "files": files, "pick": _PICKS[number]}
    sky["strength"] = uniform(
        max(ends[0] * factor[0], 1e-9), max(ends[1] * factor[1], 1e-9), per=per
    )
    sky["labels"] = labels
    if any(maps):
        sky["label_maps"] = maps
    ctx.cfg["light"] = {"sun": None, "sky": sky}


def _pass_labels_unused(params: Item) -> None:
    passes = params.get("passParams")
    if passes and passes.value:
        passes.dropped("labels of panoramas stand in HDRIList")


def _picture_labels(
    ctx: Context, vector: Item | None
) -> tuple[dict[str, str], dict[str, Any] | None]:
    """The label of a picture on each level, and its label maps."""
    if vector is None:
        return {}, None
    ids, maps = [], {}
    entries = vector.children()
    for level, entry in enumerate(entries):
        if isinstance(entry.value, dict):
            ids.append(0)
            if level < ctx.labels.levels:
                found = _label_map(ctx, entry, level)
                if found:
                    maps[f"level_{level}"] = found
            else:
                entry.dropped("no such level is rendered there (numIter)")
        else:
            ids.append(entry.whole(-(2**31)))
            if level < ctx.labels.levels:
                entry.translated(f"{_SKY}/labels")
            else:
                entry.dropped("no such level is rendered there (numIter)")
    return ctx.labels.choice(ids, "sky"), maps or None


def _label_map(ctx: Context, entry: Item, level: int) -> dict[str, Any] | None:
    """A color-coded picture and its table: ``{"1": [[r, g, b], [id]], …}``."""
    item, table = entry.need("filePath"), entry.need("mappingTable")
    file = ctx.assets.find(item, "one label for all of the picture")
    ids: dict[str, int] = {}
    for _, row in table.entries():
        cells = row.children()
        if len(cells) != 2:
            row.fault(f"{row.value}: expected [[r, g, b], [id]]")
            continue
        color = [int(v) for v in cells[0].numbers(3)]
        if not all(0 <= v <= 255 for v in color):
            cells[0].fault(f"{cells[0].value}: expected three whole numbers from 0 to 255")
            continue
        ids["#{:02X}{:02X}{:02X}".format(*color)] = int(cells[1].numbers(1)[0])
    if file is None:
        table.dropped("its picture is not there")
        return None
    if file.suffix.lower() != ".png":
        item.fault(f"{file.name}: expected a PNG file")
        return None
    table.translated(f"{_SKY}/label_maps", "a label for each color; other colors have none")
    item.translated(f"{_SKY}/label_maps")
    values = ctx.labels.values(level, ids, "sky")
    made = ctx.imported.make(f"labels_{identifier(file.stem)}_{level}.png", _rgb_writer(file))
    values.update(dict.fromkeys(sorted(_colors(file) - set(values))))
    return {"file": made, "values": values}


def _rgb(file: Path) -> np.ndarray:
    with Image.open(file) as picture:
        return np.asarray(picture.convert("RGB"))


def _rgb_writer(file: Path) -> Any:
    def write(path: Path) -> None:
        # A palette or an opacity would change what the colors are called.
        Image.fromarray(_rgb(file)).save(path)

    return write


def _colors(file: Path) -> set[str]:
    pixels = _rgb(file).reshape(-1, 3).astype(np.uint32)
    packed = np.unique(pixels[:, 0] << 16 | pixels[:, 1] << 8 | pixels[:, 2])
    return {f"#{int(value):06X}" for value in packed}


def added_light(ctx: Context, why: str) -> None:
    """A sun that stands anywhere by day, and an Earth's sky."""
    ctx.cfg["light"] = {
        "sun": {"elevation_deg": uniform(15, 80), "azimuth_deg": uniform(0, 360)},
        "sky": {"type": "atmosphere", "planet": "earth"},
    }
    ctx.imported.report.add(ADDED, "", None, "light", f"{why}: a sky of the Earth by day")
