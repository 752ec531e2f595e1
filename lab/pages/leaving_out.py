"""Writes docs/leaving_out.md: what stages leave out, what that spares, and what it changes.

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

from scenec.compiler.compile import compile_cfg
from scenec.compiler.views.illumination import MIN_VIEW_FACTOR, SHARP
from scenec.compiler.views.needed import Keep
from scenec.lab.runner import ROOT, Page, run, table
from scenec.schemas.errors import ScenecError
from scenec.schemas.report import Timings, read_output_record
from scenec.testing.pruned_extremes import CASES, Case, pruned_cfg
from scenec.testing.pruned_scenes import annotation, compiled, difference

#: Outputs that need more and more of a stage.
OUTPUTS: tuple[tuple[str, ...], ...] = (
    ("depth",),
    ("instance", "depth"),
    ("label", "depth"),
    ("label", "instance", "depth"),
    ("rgb",),
    ("rgb", "label", "instance", "depth"),
)
SPP = 64
SHIPPED = (
    "forest_edge", "jacksboro", "landing_site", "lunar_mare", "mars_yard", "meadow_edge",
    "volcanic_desert",
)  # fmt: skip

HEAD = """# Leaving out what a scene does not need

A stage holds only what its outputs need and what a camera or lidar of the batch can see the effect
of. So stages are smaller and load faster, and annotation stays the same to the bit. This page says
what stays and measures what that changes.

An object or a tile of the terrain stays if

1. it is visible: its bounding ball meets the volume of a view and is not behind the ground; or,
   with the output `rgb`,
2. its shadow, swept away from each sun and lamp, meets something visible; or
3. it is near and large enough: seen from the nearest visible place it fills {least} of a
   hemisphere or more, as a stone of 10 cm does within {near} m. An object that shines stays, too.

The first two rules are conservative: if in doubt, the object stays. The third neglects some light;
the tables below measure how much. With `rgb` the whole terrain stays. All objects stay if a mirror
may show them (a lobe of {sharp} times the diffuse part, such as metal of roughness below 0.22), or
if a picture of the sky holds a sun or lamps that were not taken out. Approximations (levels of
detail, tessellation) are chosen before and are the same with and without leaving out.

- `scenec explain OUT` lists what was left out, most effective first. `scenec explain OUT --why
  rocks/4711` says why one object is in the stage, or is not. `left_out.json` beside the stage says
  it for every instance.
- `--no-prune` keeps what no camera can see. `--keep all` also keeps what no output needs, as fine
  as it gets, for walking around in a viewer.
- Annotation is the same to the bit, except `face`, which numbers the stage's own faces.

{cores} cores, {versions}.
"""
#: What the columns of light and cost say.
COLUMNS = (
    "- **light off** is the error of the light: the root mean square difference of 8 × 8 blocks "
    "of all pictures in Mitsuba with equal noise seeds, relative to the mean. **noise** is the "
    "same difference with other seeds. A path that would have met something left out goes on "
    "differently, and its noise counts as a difference here.\n"
    "- **bytes** is the size of the whole stage over that of the pruned one; **s** is the time of "
    "pruning.\n\n"
)
#: Samples a pixel for cfgs that ship, whose pictures are large.
SHIPPED_SPP = 8


def by_outputs(page: Page) -> str:
    """What a stage of jacksboro holds for each choice of outputs."""
    cfg = json.loads((ROOT / "configs" / "jacksboro.json").read_text(encoding="utf-8"))
    if page.fast:
        cfg["terrain"]["mesh"] = {"tolerance_px": 4}
    rows = []
    for outputs in OUTPUTS[:: 3 if page.fast else 1]:
        with tempfile.TemporaryDirectory() as folder:
            batch = compiled(Path(folder), cfg | {"outputs": list(outputs)}, Keep.SEEN)
            rows.append([", ".join(f"`{n}`" for n in outputs), *_contents(batch)])
    return (
        "## By outputs\n\n`configs/jacksboro.json`, seed 1, four samples, 30,000 rocks.\n\n"
        + table(["outputs", "bytes", "files", "prims", "materials", "lights", "primvars",
                 "instances", "compile, s"], rows)
    )  # fmt: skip


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


def extremes(page: Page) -> str:
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
    return (
        "## At the limits\n\n100 m × 100 m of 5 m hills, 3,000 rocks of 5 cm to 2 m, two samples "
        "of one camera of 96 × 72 pixels, 60° wide and 1.5 m high; sun 35° high; rgb, labels and "
        "ids. Each row changes one thing. `tests/backends/test_pruned_extremes.py` holds the same "
        "facts.\n\n"
        "- **kept** counts instances that are visible, that stay for their shadow, and that stay "
        "for the light that they take or send.\n"
        "- **pixels** counts the values of all passes of annotation that differ from the whole "
        "stage's.\n"
        + COLUMNS + table(["", "kept of all", "seen + shadow + light", "pixels", "light off",
                           "noise", "bytes", "s"], rows)
    )  # fmt: skip


def shipped(page: Page) -> str:
    """A row a cfg."""
    rows = []
    for name in SHIPPED[:: 6 if page.fast else 1]:
        cfg = ROOT / "configs" / f"{name}.json"
        with tempfile.TemporaryDirectory() as folder:
            batches = []
            for keep in (Keep.SEEN, Keep.UNPRUNED):
                out = Path(folder, keep)
                compile_cfg(cfg, seed=1, out=out, batches=range(1), keep=keep,
                            cache=Path(folder, "cache"))  # fmt: skip
                batches.append(out / "batch_0000")
            rows.append([f"`{name}`", *_compared(*batches, 1 if page.fast else SHIPPED_SPP)])
    return (
        f"## Cfgs that ship\n\nUnchanged, with seed 1; {SHIPPED_SPP} samples a pixel. Most of "
        "their bytes are terrain and pictures.\n\n" + COLUMNS
        + table(["", "kept of all", "seen + shadow + light", "light off", "noise", "bytes", "s"],
                rows)
    )  # fmt: skip


def _measured(case: Case, folder: Path, spp: int) -> list[str]:
    cfg = pruned_cfg(case)
    pruned, whole = (compiled(folder, cfg, keep) for keep in (Keep.SEEN, Keep.UNPRUNED))
    kept, parts, *others = _compared(pruned, whole, spp)
    return [kept, parts, f"{differing(pruned, whole):,}", *others]


def _compared(pruned: Path, whole: Path, spp: int) -> list[str]:
    """Objects kept, why, light off, noise, bytes, seconds."""
    report = json.loads((pruned / "report.json").read_text(encoding="utf-8"))
    classes = report["prune"]["objects"].values()
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
    """Writes the page."""
    head = HEAD
    for name, value in (
        ("least", f"{MIN_VIEW_FACTOR:.2g}"),
        ("near", f"{0.05 / MIN_VIEW_FACTOR**0.5:.0f}"),
        ("sharp", f"{SHARP:.0f}"),
    ):
        head = head.replace("{" + name + "}", value)
    page.write(head, ("usd-core", "mitsuba"), (by_outputs, shipped, extremes))


if __name__ == "__main__":
    run(main, page="leaving_out")
