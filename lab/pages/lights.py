"""Renders the lights that docs/light.md shows, in every backend side by side.

    python lab/pages/lights.py [--only NAME] [--spp 16] [--keep FOLDER] [-o FOLDER] [--fast]

Each light of lights.json falls on one of the cfgs of configs/, seen from where the file says:
``place`` is the camera's x_m, y_m, height_m, ``look`` its target's distance_m, bearing_deg,
height_m, ``ev`` stops more than the metered exposure. Every frame is rendered by all three backends
from one stage. Needs all backends and bpy's HDRIs; takes six CPU minutes. With
--keep, compiled stages and frames stay in FOLDER, and frames that are there are not made again.

Those with ``bearings`` (fog, dust) are views side by side, by Mitsuba alone.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

from scenec.lab.benchmarks.cfgs import looking
from scenec.lab.pictures import beside_assets, frames, photograph, save, sheet
from scenec.lab.runner import CONFIGS, Page, names, run

BACKENDS = ("cycles", "mitsuba", "pyrender")
SIZE, HAZY_SIZE, HAZY_SPP = (384, 256), (576, 324), 16
CASES: dict[str, dict[str, Any]] = json.loads(
    Path(__file__).with_name("lights.json").read_text(encoding="utf-8")
)


def make_cfg(name: str, folder: Path) -> Path:
    """The cfg of a case, in a folder that stands beside configs/."""
    case = CASES[name]
    cfg = json.loads((CONFIGS / f"{case['cfg']}.json").read_text())
    labels = (cfg["light"].get("sky") or {}).get("labels", {})
    cfg["light"] = case["light"] | {"sky": case["light"]["sky"] | {"labels": labels}}
    cfg |= {"batches": 1, "samples": 1, "outputs": ["rgb"]}
    distance, toward, target = case["look"]
    sensor: dict[str, Any] = {"resolution": list(HAZY_SIZE if "bearings" in case else SIZE)}
    if "ev" in case:
        sensor["exposure"] = {"type": "incident", "ev_offset": case["ev"]}
    cfg["rigs"] = {
        f"view{bearing:g}": looking(
            case["place"], distance, target, bearing, fov_deg=case.get("fov_deg", 60.0), **sensor
        )
        for bearing in case.get("bearings", (toward,))
    }
    cfg.pop("$schema", None)
    path = folder / f"{name}.json"
    path.write_text(json.dumps(cfg, indent=1))
    return path


def main(page: Page) -> None:
    """Renders all lights, or the chosen ones."""
    options = page.options
    folder = options.keep or page.scratch
    spp = 2 if page.fast else options.spp
    for name, case in CASES.items():
        if options.only and name not in options.only:
            continue
        print(f"{name}: compiling and rendering", file=sys.stderr, flush=True)
        cfg = make_cfg(name, beside_assets(folder))
        if "bearings" in case:
            seen = frames(cfg, folder / name, spp=2 if page.fast else HAZY_SPP, passes=("rgb",),
                          denoise=True)  # fmt: skip
            by_camera = {frame.sidecar.camera: photograph(frame) for frame in seen}
            tiles = [("", by_camera[f"view{bearing:g}_eye"]) for bearing in case["bearings"]]
            save(sheet([tiles], HAZY_SIZE[0]), page.picture(name))
            continue
        found = {backend: frames(cfg, folder / name, backend, spp=spp, passes=("rgb",))[0]
                 for backend in BACKENDS}  # fmt: skip
        exposure = found[BACKENDS[0]].sidecar.exposure_ev
        tiles = [(backend, photograph(frame, exposure)) for backend, frame in found.items()]
        save(sheet([tiles], SIZE[0]), page.picture(name))
    page.refresh((), ())


if __name__ == "__main__":
    run(main, page="light", only=names, spp=16, keep=Path)
