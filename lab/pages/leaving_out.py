"""Makes the tables of docs/leaving_out.md: what stages leave out, and what that changes.

    python lab/pages/leaving_out.py [--fast] [-o FOLDER]

Bytes, counts and differences are facts of the code and the seeds; seconds are single readings on
the machine that runs it.
"""

from __future__ import annotations

import json
import tempfile
from pathlib import Path

import numpy as np
from pxr import Usd

from scenec.compiler.cfg.load import load
from scenec.compiler.compile import compile_cfg
from scenec.compiler.views.illumination import MIN_VIEW_FACTOR, SHARP
from scenec.compiler.views.needed import Keep
from scenec.lab.runner import ROOT, SHIPPED, Page, run
from scenec.schemas.errors import ScenecError
from scenec.schemas.manifest import REPORT
from scenec.schemas.report import BatchReport, Timings, read_output_record
from scenec.testing.pruned_extremes import CASES, Case, pruned_cfg
from scenec.testing.pruned_scenes import annotation, compiled, difference

#: Outputs that need more and more of a stage.
OUTPUTS: tuple[tuple[str, ...], ...] = (
    ("depth",), ("instance", "depth"), ("label", "depth"), ("label", "instance", "depth"),
    ("rgb",), ("rgb", "label", "instance", "depth"),
)  # fmt: skip
SPP = 64
#: Samples a pixel for cfgs that ship, whose pictures are large.
SHIPPED_SPP = 8
#: Of each.
SHIPPED_SAMPLES = 2


def by_outputs(page: Page) -> None:
    """Tables what a stage of jacksboro holds for each choice of outputs."""
    cfg = json.loads((ROOT / "configs" / "jacksboro.json").read_text(encoding="utf-8"))
    if page.fast:
        cfg["terrain"]["mesh"] = {"tolerance_px": 4}
    rows = []
    for outputs in OUTPUTS[:: 3 if page.fast else 1]:
        with tempfile.TemporaryDirectory() as folder:
            batch = compiled(Path(folder), cfg | {"outputs": list(outputs)}, Keep.SEEN)
            rows.append([", ".join(f"`{n}`" for n in outputs), *_contents(batch)])
    page.rows(rows)


def _contents(batch: Path) -> list[str]:
    """Bytes, files, prims, materials, lights, kinds of primvars, instances, seconds."""
    files = [p for p in batch.rglob("*") if p.is_file() and p.suffix != ".json"]
    stage = Usd.Stage.Open(str(batch / "stage.usda"))
    prims = list(stage.Traverse())
    types = [str(prim.GetTypeName()) for prim in prims]
    primvars = {
        name
        for prim in prims
        for name in prim.GetAuthoredPropertyNames()
        if name.startswith("primvars:") and not name.endswith(":indices")
    }
    instances = 0
    for prim in prims:
        if prim.GetTypeName() == "PointInstancer":
            found = prim.GetAttribute("protoIndices").Get(Usd.TimeCode.EarliestTime())
            instances += 0 if found is None else len(found)
    timings = read_output_record(batch.parent / "timings.json", Timings)
    return [
        f"{sum(p.stat().st_size for p in files):,}",
        str(len(files)),
        f"{len(prims):,}",
        str(types.count("Material")),
        str(sum("Light" in name for name in types)),
        str(len(primvars)),
        f"{instances:,}",
        f"{sum(timings.compile[batch.name].values()):.1f}",
    ]


def extremes(page: Page) -> None:
    """A row a case."""
    rows = []
    cases = list(CASES.items())[:: 8 if page.fast else 1]
    for _, case in cases:
        with tempfile.TemporaryDirectory() as folder:
            try:
                rows.append([case.what, *_measured(case, Path(folder), 16 if page.fast else SPP)])
            except ScenecError as error:
                message = str(error).splitlines()[0].split(": ", 1)[-1].replace("|", "\\|")
                rows.append([case.what, f"refused: {message}", *[""] * 6])
    page.rows(rows)


def shipped(page: Page) -> None:
    """A row a cfg."""
    rows = []
    for name in SHIPPED[:: 6 if page.fast else 1]:
        cfg = load(ROOT / "configs" / f"{name}.json", [f"samples={SHIPPED_SAMPLES}"])
        with tempfile.TemporaryDirectory() as folder:
            batches = []
            for keep in (Keep.SEEN, Keep.UNPRUNED):
                out = Path(folder, keep)
                compile_cfg(cfg, seed=1, out=out, batches=range(1), keep=keep,
                            cache=Path(folder, "cache"))  # fmt: skip
                batches.append(out / "batch_0000")
            spp = 1 if page.fast else SHIPPED_SPP
            rows.append([f"`{name}`", *_compared(batches[0], batches[1], spp)])
    page.rows(rows)


def _measured(case: Case, folder: Path, spp: int) -> list[str]:
    cfg = pruned_cfg(case)
    pruned, whole = (compiled(folder, cfg, keep) for keep in (Keep.SEEN, Keep.UNPRUNED))
    kept, parts, *others = _compared(pruned, whole, spp)
    return [kept, parts, f"{differing(pruned, whole):,}", *others]


def _compared(pruned: Path, whole: Path, spp: int) -> list[str]:
    """Objects kept, why, light off, noise, bytes, seconds."""
    prune = read_output_record(pruned / REPORT, BatchReport).prune
    classes = prune.objects.values() if prune else ()
    kept = [sum(one.get(name, 0) for one in classes) for name in ("seen", "shadow", "light")]
    drawn = sum(sum(one.values()) - one.get("not placed", 0) for one in classes)
    timings = read_output_record(pruned.parent / "timings.json", Timings)
    lit = difference(pruned, whole, spp)
    sizes = [
        sum(p.stat().st_size for p in batch.rglob("*") if p.is_file() and p.suffix != ".json")
        for batch in (whole, pruned)
    ]
    return [
        f"{sum(kept):,} of {drawn:,}",
        " + ".join(f"{n:,}" for n in kept),
        f"{100 * lit.paired:.2g} %" if lit.blocks else "dark",
        f"{100 * lit.noise:.2g} %" if lit.blocks else "",
        f"{sizes[0] / sizes[1]:.3g} ×",
        f"{timings.compile[pruned.name].get('prune', 0.0):.2f}",
    ]


def differing(pruned: Path, whole: Path) -> int:
    """Values of annotation that differ between two stages of the same views."""
    count = 0
    for (_, one), (_, other) in zip(annotation(pruned), annotation(whole), strict=True):
        for key, values in other.items():
            same = (one[key] == values) | ((one[key] != one[key]) & (values != values))
            count += int(np.count_nonzero(~same))
    return count


def main(page: Page) -> None:
    """Refreshes the page."""
    page.value("least", f"{MIN_VIEW_FACTOR:.2g}")
    page.value("near", f"{0.05 / MIN_VIEW_FACTOR**0.5:.0f} m")
    page.value("sharp", f"{SHARP:.0f}")
    page.refresh(("usd-core", "mitsuba"), (by_outputs, shipped, extremes))


if __name__ == "__main__":
    run(main, page="leaving_out")
