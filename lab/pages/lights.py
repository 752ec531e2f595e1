"""Renders six lights in every backend, side by side, and writes docs/lights.md.

    python lab/pages/lights.py [--only NAME] [--spp 16] [--keep FOLDER] [-o FOLDER] [--fast]

Each light falls on one of the cfgs of configs/, with the light and the camera put in place by this
script. Every frame is rendered by all three backends from one stage; the table holds mean radiance,
FLIP and seconds. Needs all backends, bpy's HDRIs and the extra "flip"; takes ten minutes or so on
two cores. With --keep, compiled stages and frames stay in FOLDER, and frames that are there are not
made again.

Pictures of haze, which docs/light.md shows, are made where --only names them (fog, dust), by
Mitsuba alone.
"""

from __future__ import annotations

import copy
import json
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from scenec.backends.check.radiance import flip
from scenec.backends.run.render import render
from scenec.compiler.compile import compile_cfg
from scenec.lab.runner import ROOT, Page, names, run, table
from scenec.schemas.errors import ScenecError
from scenec.schemas.files import atomic
from scenec.schemas.frames import Frame, read_frame
from scenec.schemas.picture import develop

BACKENDS = ("cycles", "mitsuba", "pyrender")
#: What FLIP is taken against; Mitsuba's error is measured against Cycles too.
REFERENCE = "cycles"
SEED = 1
SIZE = (384, 256)
WIDTH = 384
_GAP = 6
_LEGEND = 22
_INK = (34, 34, 34)


@dataclass(frozen=True)
class Case:
    """One light.

    Attributes:
        name: Of its files.
        title: In the page.
        cfg: Of configs/.
        light: Takes the place of the cfg's light, but for the sky's labels.
        place: Camera: x_m, y_m, height_m above the ground.
        look: Its target: distance_m, bearing_deg, height_m above the ground.
        about: What the page says to it.
        ev: Stops more than the metered exposure.
        bearings: Of cameras side by side, which one renderer draws, in place of ``look``'s.
    """

    name: str
    title: str
    cfg: str
    light: dict[str, Any]
    place: tuple[float, float, float]
    look: tuple[float, float, float]
    about: str
    ev: float = 0.0
    fov_deg: float = 60.0
    more: dict[str, Any] = field(default_factory=dict)
    bearings: tuple[float, ...] = ()


def _sun(elevation: float, azimuth: float) -> dict[str, Any]:
    return {"elevation_deg": elevation, "azimuth_deg": azimuth}


CASES = (
    Case(
        "earth_noon",
        "Earth, noon",
        "volcanic_desert",
        {
            "sun": _sun(62, 160),
            "sky": {"type": "atmosphere", "planet": "earth", "scattering": "multiple"},
        },
        (18, -26, 2.0),
        (14, 335, 0.3),
        "The sun stands 62° high in clear air.",
    ),
    Case(
        "earth_dusk",
        "Earth, dusk",
        "volcanic_desert",
        {
            "sun": _sun(2.5, 290),
            "sky": {
                "type": "atmosphere",
                "planet": "earth",
                "scattering": "multiple",
                "dust_density": 2,
            },
        },
        (18, -26, 2.0),
        (14, 335, 0.3),
        "The sun stands 2.5° high, in air with twice the usual aerosol.",
        ev=-1.3,
    ),
    Case(
        "mars_noon",
        "Mars, noon",
        "mars_yard",
        {
            "sun": _sun(60, 140),
            "sky": {"type": "atmosphere", "planet": "mars", "scattering": "multiple"},
        },
        (-2, -6, 1.9),
        (9, 15, 0.0),
        "The sun stands 60° high in the usual dust.",
    ),
    Case(
        "mars_sunset",
        "Mars, sunset",
        "mars_yard",
        {
            "sun": _sun(6, 352),
            "sky": {"type": "atmosphere", "planet": "mars", "scattering": "multiple"},
        },
        (-2, -6, 1.9),
        (22, 349, 2.6),
        "The sun stands 6° high; the camera looks into its blue aureole, and is exposed "
        "for the sky.",
        ev=-6.3,
        fov_deg=45.0,
    ),
    Case(
        "moon_low_sun",
        "Moon, low sun",
        "lunar_mare",
        {"sun": _sun(8, 100), "sky": {"type": "atmosphere", "planet": "moon"}},
        (5, -8, 1.7),
        (10, 20, 0.0),
        "The sun stands 8° high in a black sky; Hapke's reflectance.",
    ),
    Case(
        "overcast",
        "Overcast HDRI",
        "meadow_edge",
        {
            "sky": {
                "type": "image",
                "files": ["package:bpy/*/datafiles/studiolights/world/city.exr"],
                "rotation_deg": 0,
                "sun": "extract",
            }
        },
        (0, 0, 1.6),
        (12, 30, 0.4),
        "A photographed sky under thin cloud; its sun became a light of its own.",
    ),
)

#: Of docs/light.md.
HAZY = (
    Case(
        "fog",
        "Morning fog",
        "meadow_edge",
        {
            "sun": _sun(9, 130),
            "sky": {"type": "atmosphere", "scattering": "multiple", "altitude_m": 400},
            "haze": {"visibility_m": 50, "scale_height_m": 2.5, "asymmetry": 0.85},
        },
        (0, 0, 1.7),
        (12, 0, 0.9),
        "",
        bearings=(126, 310),
    ),
    Case(
        "dust",
        "Dust on Mars",
        "mars_yard",
        {
            "sun": _sun(35, 130),
            "sky": {"type": "atmosphere", "planet": "mars", "scattering": "multiple"},
            "haze": {
                "visibility_m": 150,
                "scale_height_m": 30,
                "asymmetry": 0.65,
                "albedo": [0.95, 0.85, 0.7],
            },
        },
        (0, 0, 1.9),
        (12, 0, 0.6),
        "",
        bearings=(120, 310),
    ),
)
#: Pixels of each of their views, and samples a pixel, without noise afterwards.
HAZY_SIZE, HAZY_SPP = (576, 324), 16


def make_cfg(case: Case, folder: Path) -> Path:
    """The cfg of a case, in a folder that stands beside configs/."""
    cfg = json.loads((ROOT / "configs" / f"{case.cfg}.json").read_text())
    labels = (cfg["light"].get("sky") or {}).get("labels", {})
    cfg["light"] = copy.deepcopy(case.light)
    cfg["light"]["sky"]["labels"] = labels
    cfg |= {"batches": 1, "samples": 1, "outputs": ["rgb", "depth"]}
    x, y, height = case.place
    distance, towards, target = case.look
    size = HAZY_SIZE if case.bearings else SIZE
    cfg["rigs"] = {
        f"view{bearing:g}" if case.bearings else "view": {
            "pose": {
                "type": "random_target",
                "position": {"x_m": x, "y_m": y, "height_m": height},
                "target": {
                    "distance_m": distance,
                    "bearing_deg": bearing,
                    "height_m": target,
                },
            },
            "sensors": {"eye": {"resolution": list(size), "fov_deg": case.fov_deg}},
        }
        for bearing in case.bearings or (towards,)
    }
    if case.ev:
        cfg["rigs"]["view"]["sensors"]["eye"]["exposure"] = {
            "type": "incident",
            "ev_offset": case.ev,
        }
    cfg |= case.more
    cfg.pop("$schema", None)
    path = folder / f"{case.name}.json"
    path.write_text(json.dumps(cfg, indent=1))
    return path


def compiled(case: Case, folder: Path) -> Path:
    """The folder of a case's stage.

    Raises:
        ScenecError: It cannot be compiled.
    """
    # Files that a cfg names lie relative to it.
    (folder / "configs").mkdir(parents=True, exist_ok=True)
    if not (folder / "assets").exists():
        (folder / "assets").symlink_to(ROOT / "assets")
    compile_cfg(make_cfg(case, folder / "configs"), seed=SEED, out=folder / case.name)
    return folder / case.name


def views(case: Case, folder: Path, spp: int) -> Image.Image:
    """Views of a case side by side, as Mitsuba draws them.

    Raises:
        ScenecError: It cannot be compiled, or a frame could not be made.
    """
    report = render(compiled(case, folder), "mitsuba", spp=spp, passes=("rgb",), denoise=True)
    if report.failed:
        raise ScenecError(f"{case.name}: {'; '.join(report.failed)}")
    width, height = HAZY_SIZE
    made = Image.new("RGB", (len(report.frames) * (width + _GAP) - _GAP, height), (255, 255, 255))
    by_camera = {path.parent.name: path for path in report.frames}
    for i, bearing in enumerate(case.bearings):
        frame = read_frame(by_camera[f"view{bearing:g}_eye"])
        shown = develop(frame.passes["rgb"], frame.sidecar.exposure_ev)
        made.paste(Image.fromarray(shown), (i * (width + _GAP), 0))
    return made


def frames(case: Case, folder: Path, spp: int) -> dict[str, Frame]:
    """The frame of each backend.

    Raises:
        ScenecError: It cannot be compiled, or a frame could not be made.
    """
    out = compiled(case, folder)
    found = {}
    for backend in BACKENDS:
        report = render(out, backend, spp=spp, passes=("rgb", "depth"))
        if not report.frames:
            why = "; ".join(report.failed) or "no frame was made"
            raise ScenecError(f"{case.name}, {backend}: {why}")
        found[backend] = read_frame(report.frames[0])
    return found


def sheet(found: dict[str, Frame]) -> Image.Image:
    """The backends' pictures side by side, with their names."""
    tile = (WIDTH, round(WIDTH * SIZE[1] / SIZE[0]))
    made = Image.new("RGB", (3 * tile[0] + 2 * _GAP, tile[1] + _LEGEND), (255, 255, 255))
    draw, font = ImageDraw.Draw(made), ImageFont.load_default(14)
    for i, (backend, frame) in enumerate(found.items()):
        exposure = found[REFERENCE].sidecar.exposure_ev
        shown = Image.fromarray(develop(frame.passes["rgb"], exposure))
        made.paste(shown.resize(tile, Image.Resampling.LANCZOS), (i * (tile[0] + _GAP), 0))
        draw.text((i * (tile[0] + _GAP) + 2, tile[1] + 3), backend, _INK, font)
    return made


def row(case: Case, found: dict[str, Frame]) -> list[str]:
    """A line of the table."""
    means, flips, seconds = [], [], []
    reference = found[REFERENCE].passes["rgb"]
    on = np.isfinite(found[REFERENCE].passes["depth"])
    for backend, frame in found.items():
        mean = frame.passes["rgb"][on].astype(np.float64).mean(axis=0)
        means.append(" ".join(f"{value:.3g}" for value in mean))
        if backend != REFERENCE:
            # The renderer's own noise is in it.
            values = flip(found[REFERENCE], frame)
            flips.append("?" if values is None else f"{float(values.mean()):.3f}")
            off = frame.passes["rgb"][on].astype(np.float64).mean()
            flips[-1] += f" ({100.0 * (off / float(reference[on].mean()) - 1.0):+.1f} %)"
        spent = frame.sidecar.seconds or {}
        seconds.append(f"{spent['radiance']:.1f}")
    return [case.title, *means, *flips, *seconds]


HEAD = """# Six lights, three renderers

Shipped cfgs under other lights, 16 samples a pixel, \
384 × 256 pixels, seed 1, on {cores} cores ({versions}). There is one stage for each \
light. Each backend renders it, and all pictures of a row have one exposure.
"""

NOTES = """
Radiance is that of surfaces, W/(m² sr), red, green, blue; FLIP is LDR-FLIP's mean over all pixels \
against Cycles (0 is equal; the noise of both counts), and beside it how far the mean radiance \
of surfaces is from Cycles'. Seconds are those of the radiance alone, without loading and \
compiling the scene; Mitsuba's include the compilation of its kernel, 20 to 40 s for each stage. \
They are single readings on a machine that had other work.
"""


def main(page: Page) -> None:
    """Renders, and writes the page where no light was chosen."""
    options, rows, parts = page.options, [], []
    for case in HAZY if options.only else ():
        if case.name in options.only:
            made = views(case, options.keep or page.scratch, 2 if page.fast else HAZY_SPP)
            with atomic(page.picture(case.name)) as target:
                made.save(target, format="PNG", optimize=True)
    for case in CASES:
        if options.only and case.name not in options.only:
            continue
        print(f"{case.name}: compiling and rendering", file=sys.stderr, flush=True)
        found = frames(case, options.keep or page.scratch, 2 if page.fast else options.spp)
        rows.append(row(case, found))
        small = sheet(found).quantize(256, dither=Image.Dither.NONE)
        with atomic(page.picture(case.name)) as target:
            small.save(target, format="PNG", optimize=True)
        shown = page.shown(case.name, f"{case.title} in {', '.join(BACKENDS)}")
        about = f"{case.about} Ground: `configs/{case.cfg}.json`."
        parts.append(f"## {case.title}\n\n{about}\n\n{shown}")
    others = [b for b in BACKENDS if b != REFERENCE]
    header = ["light", *(f"radiance, {b}" for b in BACKENDS), *(f"FLIP, {b}" for b in others)]
    header += [f"seconds, {b}" for b in BACKENDS]
    page.say(table(header, rows))
    if not options.only:
        text = "## All of them\n\n" + table(header, rows) + NOTES
        packages = ("mitsuba", "bpy", "pyrender-maintained")
        page.write(HEAD, packages, [lambda _, part=part: part for part in (text, *parts)])


if __name__ == "__main__":
    run(main, page="lights", only=names, spp=16, keep=Path)
