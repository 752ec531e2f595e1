"""Skies, panoramas, lamps, haze and finished pictures have the same bytes in all circumstances."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from elsewhere import COMPILE, printed_elsewhere
from test_compile import compiled, hashes

from scenec.schemas.exr import write_rgb
from scenec.testing.small import small_cfg, write_cfg


def lit_cfg(folder: Path, sky: dict[str, Any]) -> dict[str, Any]:
    """Everything about light and surfaces that changes bytes, on a small ground."""
    cfg = small_cfg(samples=2)
    del cfg["light"]["sun"]
    cfg["light"] |= {
        "sky": sky | {"labels": {"class": "sky", "surface": "sky"}},
        "haze": {"visibility_m": {"type": "uniform", "min": 200, "max": 900}, "scale_height_m": 90},
        "more": {"Earth": {"type": "earthshine", "phase_deg": 50}},
        "lamps": {
            "lamp": {
                "mount": {"type": "rig", "rig": "rover", "position_m": [0.2, 0, 0]},
                "intensity": {"type": "uniform", "min": 90, "max": 110},
            }
        },
    }
    ground = {"type": "mud_cracks", "resolution": 128, "displacement": True}
    maps = {"size_m": 1.1, "procedural": ground, "cells": {}, "far": {}}
    cfg["materials"]["mud"] |= {"maps": maps, "reflectance": {"type": "hapke"}}
    cfg["materials"]["gravel"]["maps"] = {
        "procedural": {"type": "gravel", "resolution": 256},
        "cells": {},
    }
    cfg["terrain"]["ground"][1]["height_blend"] = 0.4
    return cfg


def panorama(folder: Path) -> dict[str, Any]:
    """A picture with a sun in it, which is taken out."""
    rng = np.random.default_rng(5)
    picture = rng.uniform(0.5, 1.5, (32, 64, 3)).astype(np.float32)
    picture[9:11, 20:22] = 4000.0
    write_rgb(folder / "sky.exr", picture)
    return {"type": "image", "files": ["sky.exr"], "pick": "shuffled", "sun": "extract"}


SKIES = {
    "mars": {"type": "atmosphere", "planet": "mars", "scattering": "multiple", "resolution": 16},
    "panorama": None,
}


@pytest.mark.invariant
@pytest.mark.slow
def test_all_of_light_has_the_same_bytes_in_all_circumstances_at_once(tmp_path):
    for name, sky in SKIES.items():
        folder = tmp_path / name
        folder.mkdir()
        cfg = lit_cfg(folder, sky or panorama(folder))
        reference = compiled(folder, cfg, name="here")
        path = write_cfg(folder, cfg, "there.json")
        printed_elsewhere(COMPILE, path, folder / "there")
        assert hashes(folder / "there") == hashes(reference), name
