"""Measures the ground of the cfgs of configs/ beside photographs, for docs/photographs.md.

    python lab/pages/photographs.py [--only NAME] [--samples 4] [--spp 8] [--keep FOLDER]
        [-o FOLDER] [--fast]

Every sample is rendered twice by Mitsuba, with independent noise, which thereby drops out
(``scenec.testing.ground_statistics``). Figures are kept in docs/photographs.json, so that
``--only`` measures some cfgs anew. 30 to 60 CPU seconds a cfg, minutes one with leaves.
"""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

import numpy as np

from scenec.compiler.cfg.load import load
from scenec.lab.pictures import frames
from scenec.lab.runner import CONFIGS, Page, cell, names, run
from scenec.schemas.frames import Frame
from scenec.schemas.picture import luminance
from scenec.testing.ground_statistics import View, in_angles, measure

#: What is no ground, by its name in the level ``class``.
_NO_GROUND = ("sky", "hardware")


def views(page: Page, name: str) -> list[View]:
    """The samples of a cfg, each rendered twice."""
    count, spp = (1, 2) if page.fast else (page.options.samples, page.options.spp)
    out = (page.options.keep or page.scratch) / name
    spec = load(CONFIGS / f"{name}.json", settings=[f"samples={count}"])
    how = {"spp": spp, "passes": ("rgb", "label"), "replace": True}
    halves = [frames(spec, out, noise_seed=seed, **how) for seed in (0, 1)]
    return [_view(one, other) for one, other in zip(*halves, strict=True)]


def _view(one: Frame, other: Frame) -> View:
    names_of = one.sidecar.labels["class"]
    away = [0, *(int(number) for number, name in names_of.items() if name in _NO_GROUND)]
    ground = ~np.isin(one.passes["label.class"], away)
    halves = [luminance(np.asarray(f.passes["rgb"], np.float64)) for f in (one, other)]
    return in_angles(halves, ground, one.sidecar.intrinsics)


def main(page: Page) -> None:
    """Measures, and refreshes figures and page."""
    kept = page.folder / "photographs.json"
    figures = json.loads(kept.read_text(encoding="utf-8")) if kept.exists() else {}
    for name in page.options.only or sorted(path.stem for path in CONFIGS.glob("*.json")):
        seen = views(page, name)
        figures[name] = {"samples": len(seen), **asdict(measure(seen))}
        print(f"{name}: {figures[name]}", flush=True)
        kept.write_text(json.dumps(figures, indent=1, sort_keys=True) + "\n", encoding="utf-8")
    page.rows(None)
    rows = []
    for name, of in sorted(figures.items()):
        numbers = (*of["bands"], of["slope"], of["kurtosis"])
        cells = [str(of["samples"]), *(cell(round(value, 3)) for value in numbers)]
        rows.append([name, *cells, *(f"{value:+.2f}" for value in of["percentiles"])])
    page.rows(rows)
    page.refresh(("mitsuba",), ())


if __name__ == "__main__":
    run(main, page="photographs", only=names, samples=4, spp=8, keep=Path)
