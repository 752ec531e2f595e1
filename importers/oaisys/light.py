"""``ENVIRONMENT_EFFECTS_SETUP``: sun, sky and panoramas."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from scenec.importers.numbers import mean, scaled, uniform
from scenec.importers.oaisys.context import DEAD, Context, label_vector
from scenec.importers.scene import identifier
from scenec.importers.source import Item

#: Solar irradiance above the atmosphere, W/m².
_SOLAR = 1361.0
_SUN, _SKY = "light/sun", "light/sky"
#: Of a sky: key, where it goes, least and most, and what is usual there.
_SKY_KEYS = (
    ("SunSize", "sun", "diameter_deg", 0.0, 90.0, (0.545, 0.545)),
    ("SunElevation", "sun", "elevation_deg", -90.0, 90.0, (15.0, 90.0)),
    ("SunRotation", "sun", "azimuth_deg", -1e5, 1e5, (0.0, 360.0)),
    ("SunAltitude", "sky", "altitude_m", 0.0, 60000.0, (3000.0, 3350.0)),
    ("AirDensity", "sky", "air_density", 0.0, 10.0, (1.0, 2.0)),
    ("DustDensity", "sky", "dust_density", 0.0, 10.0, (0.0, 10.0)),
    ("OzoneDensity", "sky", "ozone_density", 0.0, 10.0, (0.0, 5.0)),
)
#: How the next panorama is chosen, by ``selectionOption``.
_PICKS = ("in_turn", "random", "shuffled")


def light(ctx: Context, setup: Item) -> None:
    """The light; of several effects, the first."""
    general = setup.object("GENERAL")
    strength = general.get("backgroundStrength")
    ends = strength.span(0.0, 1e6, (1.0, 1.0))
    effects = setup.need("ENVIRONMENT_EFFECTS").children()
    for other in effects[1:]:
        other.dropped("a scene has one sky: the first")
    if not effects:
        strength.dropped("there is no effect that it is the strength of")
        added_light(ctx, "the cfg has no light")
        return
    params = effects[0].need("environmentEffectsParams")
    kind = effects[0].need("type").translated(_SKY)
    is_sky = kind.one_of("EnvLightBlenderSky", "EnvHDRI") == "EnvLightBlenderSky"
    per = _per(ctx, params)
    if is_sky:
        _sky(ctx, params, per)
        _strength(ctx, strength, ends, per)
    else:
        _panoramas(ctx, params, ends, per)
        strength.translated(f"{_SKY}/strength")
    for owner in (general, effects[0]):
        owner.drop("the interval that counts stands in environmentEffectsParams", "stepInterval")


def _strength(ctx: Context, item: Item, ends: tuple[float, float], per: str) -> None:
    if ends[0] == ends[1] or not mean(ends):
        item.dropped("light has its physical strength, and exposure follows it")
        return
    ctx.cfg["light"]["sun"]["irradiance"] = scaled(ends, _SOLAR / mean(ends), per=per)
    item.approximated(f"{_SUN}/irradiance", "as a factor whose mean is 1: exposure follows light")


def _per(ctx: Context, params: Item) -> str:
    """Returns how often light is drawn: "" is once a sample."""
    option, step = params.get("stepIntervalOption"), params.get("stepInterval")
    option.translated("light").one_of("GLOBAL", "LOCAL")
    interval = step.whole(1, usual=1)
    if interval == 1:
        step.translated("light", "drawn once a sample")
    elif interval >= ctx.cfg["samples"]:
        step.translated("light", "drawn once a batch")
        return "batch"
    else:
        step.approximated("light", "drawn once a sample")
    return ""


def _sky(ctx: Context, params: Item, per: str) -> None:
    light: dict[str, Any] = {"sun": {}, "sky": {"type": "atmosphere", "planet": "earth"}}
    ctx.cfg["light"] = light
    ctx.cfg["light"] = light
    for key, owner, ours, low, high, usual in _SKY_KEYS:
        item = params.get(key).translated(f"light/{owner}/{ours}")
        light[owner][ours] = uniform(*item.span(low, high, usual), per=per)
    intensity = params.get("SunIntensity")
    ends = intensity.span(1e-6, 1e6, (1.0, 1.0))
    is_usual = ends == (1.0, 1.0)
    if not is_usual:
        light["sun"]["irradiance"] = scaled(ends, _SOLAR, per=per)
    intensity.approximated(f"{_SUN}/irradiance", "" if is_usual else "the sky follows the sun")
    params.drop(DEAD, "SunStrength")
    passes = params.object("passParams")
    passes.object("RGBDPass").drop(DEAD, "rgbIDVec")
    passes.object("InstancePass").drop(DEAD, "instanceIDVec")
    vector = passes.object("SemanticPass").get("semanticIDVec")
    light["sky"]["labels"] = label_vector(ctx, vector, "sky", f"{_SKY}/labels") if vector else {}


def _panoramas(ctx: Context, params: Item, factor: tuple[float, float], per: str) -> None:
    option = params.get("selectionOption")
    pick = _PICKS[option.whole(0, 2, 2)]
    option.translated(f"{_SKY}/pick", pick)
    files: list[str] = []
    maps: list[dict[str, Any] | None] = []
    strengths: list[tuple[float, float]] = []
    strength_items: list[Item] = []
    first: list[int] | None = None
    for entry in params.need("HDRIList").children():
        item, strength = entry.need("filePath"), entry.get("strength")
        file = ctx.assets.find(item, "a sky of the Earth")
        ends = strength.span(1e-9, 1e6, (1.0, 1.0))
        if file is None:
            entry.drop("its picture is not there", "strength", "labelIDVec")
            continue
        if file.suffix.lower() not in (".exr", ".png", ".jpg", ".jpeg", ".tif", ".tiff"):
            item.fault(f"{file.name}: expected a panorama as OpenEXR; convert it (oiiotool, GIMP)")
        item.translated(f"{_SKY}/files/{len(files)}")
        files.append(ctx.imported.refer(file))
        strengths.append(ends)
        strength_items.append(strength)
        ids, of = _picture_labels(ctx, entry.get("labelIDVec"))
        first = ids if first is None else first
        for level in range(ctx.labels.levels):
            own, usual = (given[level] if level < len(given) else 0 for given in (ids, first))
            if own != usual and f"level_{level}" not in of:
                of[f"level_{level}"] = _even_map(ctx, level, own)
        maps.append(of or None)
    if params.get("passParams").value:
        params.drop("labels of panoramas stand in HDRIList", "passParams")
    if not files:
        added_light(ctx, "no panorama is there")
        return
    same = len(set(strengths)) == 1
    for strength in strength_items:
        if same:
            strength.translated(f"{_SKY}/strength")
        else:
            note = "one range for all panoramas, from the least of theirs to the most"
            strength.approximated(f"{_SKY}/strength", note)
    low, high = min(a for a, _ in strengths), max(b for _, b in strengths)
    sky: dict[str, Any] = {"type": "image", "files": files, "pick": pick}
    sky["strength"] = uniform(max(low * factor[0], 1e-9), max(high * factor[1], 1e-9), per=per)
    sky["labels"] = ctx.labels.choice(first or [], "sky")
    if any(maps):
        sky["label_maps"] = maps
    ctx.cfg["light"] = {"sun": None, "sky": sky}


def _picture_labels(ctx: Context, vector: Item) -> tuple[list[int], dict[str, Any]]:
    """Returns the label of a picture on each level, and its label maps by level."""
    ids: list[int] = []
    maps: dict[str, Any] = {}
    for level, entry in enumerate(vector.children()):
        is_map = isinstance(entry.value, dict)
        ids.append(0 if is_map else entry.whole(-(2**31)))
        if level >= ctx.labels.levels:
            entry.dropped("no such level is rendered there (numIter)")
        elif not is_map:
            entry.translated(f"{_SKY}/labels")
        elif found := _label_map(ctx, entry, level):
            maps[f"level_{level}"] = found
    return ids, maps


def _even_map(ctx: Context, level: int, number: int) -> dict[str, Any]:
    """Makes a label map of one texel, for a panorama whose label is not the first one's."""
    values = ctx.labels.values(level, {"#000000": number}, "sky")
    return {"file": ctx.imported.make("labels_even.png", _write_black), "values": values}


def _write_black(path: Path) -> None:
    Image.new("RGB", (1, 1)).save(path)


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
    # A palette or an opacity would change what the colors are called.
    with Image.open(file) as opened:
        picture = opened.convert("RGB")
    values = ctx.labels.values(level, ids, "sky")
    values.update(dict.fromkeys(sorted(_colors(picture) - set(values))))
    name = f"labels_{identifier(file.stem)}_{level}.png"
    return {"file": ctx.imported.make(name, picture.save), "values": values}


def _colors(picture: Image.Image) -> set[str]:
    pixels = np.asarray(picture).reshape(-1, 3).astype(np.uint32)
    packed = np.unique(pixels[:, 0] << 16 | pixels[:, 1] << 8 | pixels[:, 2])
    return {f"#{int(value):06X}" for value in packed}


def added_light(ctx: Context, why: str) -> None:
    """A sun that stands anywhere by day, and an Earth's sky."""
    ctx.cfg["light"] = {
        "sun": {"elevation_deg": uniform(15, 80), "azimuth_deg": uniform(0, 360)},
        "sky": {"type": "atmosphere", "planet": "earth"},
    }
    ctx.imported.report.added("light", f"{why}: a sky of the Earth by day")
