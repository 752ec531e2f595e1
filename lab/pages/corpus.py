"""Counts which stages of a folder are drawn, and why others are not.

    python lab/pages/corpus.py --folder FOLDER [--fast] [-o FILE]

Each .usd, .usda, .usdc and .usdz file below it is framed by a camera of one's own, from a layer
beside it that has it as its sublayer; nothing is written into the folder. Drawn is a stage that the
exact caster meets; empty is one that is read, and in which it meets nothing.
"""

from __future__ import annotations

import re
from collections import Counter
from pathlib import Path

import numpy as np
from pxr import Gf, Tf, Usd, UsdGeom

from scenec.backends.run.session import Session
from scenec.backends.stage.read import read_stage
from scenec.lab.runner import Study, run
from scenec.schemas.errors import ScenecError

_SUFFIXES = (".usd", ".usda", ".usdc", ".usdz")
#: Of a picture, and from where it is taken: seen from the middle, in its radii.
_PIXELS, _FROM = 128, np.array([1.2, -2.2, 1.0])


def framed(stage_file: Path, wrapper: Path) -> None:
    """Writes a stage that has another one as its sublayer, and a camera that shows all of it.

    Raises:
        Tf.ErrorException: USD cannot open it.
    """
    stage = Usd.Stage.Open(str(stage_file))
    around = Usd.Stage.CreateNew(str(wrapper))
    around.GetRootLayer().subLayerPaths.append(str(stage_file.resolve()))
    UsdGeom.SetStageMetersPerUnit(around, UsdGeom.GetStageMetersPerUnit(stage))
    up = UsdGeom.GetStageUpAxis(stage)
    UsdGeom.SetStageUpAxis(around, up)
    first = stage.GetStartTimeCode()
    around.SetStartTimeCode(first)
    around.SetEndTimeCode(first)
    purposes = [UsdGeom.Tokens.default_, UsdGeom.Tokens.render]
    bounds = UsdGeom.BBoxCache(Usd.TimeCode.EarliestTime(), purposes)
    box = bounds.ComputeWorldBound(stage.GetPseudoRoot()).ComputeAlignedRange()
    low, high = (
        (np.zeros(3), np.ones(3)) if box.IsEmpty() else np.array([box.GetMin(), box.GetMax()])
    )
    radius = max(0.5 * float(np.linalg.norm(high - low)), 1e-6)
    way = _FROM if up == "Z" else _FROM[[0, 2, 1]] * (1, 1, -1)
    eye = 0.5 * (low + high) + radius * way * 1.3
    view = Gf.Matrix4d().SetLookAt(
        Gf.Vec3d(*eye), Gf.Vec3d(*(0.5 * (low + high))), Gf.Vec3d(0, up != "Z", up == "Z")
    )
    camera = UsdGeom.Camera.Define(around, "/OwnCamera")
    camera.AddTransformOp().Set(view.GetInverse())
    camera.CreateFocalLengthAttr(30.0)
    camera.CreateVerticalApertureAttr(camera.GetHorizontalApertureAttr().Get())
    product = around.DefinePrim("/OwnProduct", "RenderProduct")
    product.CreateRelationship("camera").SetTargets(["/OwnCamera"])
    product.GetAttribute("resolution").Set(Gf.Vec2i(_PIXELS, _PIXELS))
    around.GetRootLayer().Save()


def outcome(file: Path, wrapper: Path) -> tuple[str, str]:
    """Draws a stage: "drawn", "empty" or "refused", and why."""
    try:
        framed(file, wrapper)
        scene = read_stage(wrapper)
        camera = next(c for c in scene.cameras[0] if c.path == "/OwnCamera")
        depth = Session(scene, None).render(camera, 0, ("depth",), 1, 0).arrays["depth"]
    except Tf.ErrorException:
        return "refused", "USD itself cannot open it"
    except ScenecError as error:
        return "refused", str(error)
    return ("drawn" if np.isfinite(depth).any() else "empty"), "; ".join(scene.losses)


def main(study: Study) -> None:
    """Prints a line a stage that is not drawn, counts, and the commonest losses."""
    folder = study.options.folder
    files = sorted(f for f in folder.rglob("*") if f.suffix.lower() in _SUFFIXES)
    counts: Counter[tuple[str, str]] = Counter()
    losses: Counter[str] = Counter()
    for number, file in enumerate(files[:: 20 if study.fast else 1]):
        named = file.relative_to(folder)
        found, why = outcome(file, study.scratch / f"{number}.usda")
        counts[named.parts[0], found] += 1
        if found != "drawn":
            short = re.sub(r"\S*/\d+\.usda: ", "", why)
            study.say(f"{found}: {named}: {short[:300]}")
        losses.update({line.split(":")[0] for line in why.split("; ")} if found == "drawn" else ())
    study.say("")
    kinds = ("drawn", "empty", "refused")
    study.table(
        ["folder", *kinds],
        ([top, *(counts[top, k] for k in kinds)] for top in sorted({t for t, _ in counts})),
    )
    study.table(["loss", "stages"], losses.most_common(25))


if __name__ == "__main__":
    run(main, folder=Path)
