"""The frames of a batch: which there are, where each goes, what makes it."""

from __future__ import annotations

import os
from collections.abc import Collection, Iterator, Sequence
from contextlib import suppress

from scenec.backends.noise_seeds import frame_seed
from scenec.backends.run.plan import RenderPlan
from scenec.backends.run.units import CameraFacts, Opened, Opening, RenderFrame
from scenec.schemas.errors import BackendError, FrameError, StageError
from scenec.schemas.files import inside
from scenec.schemas.frames import frame_stem
from scenec.schemas.manifest import FRAMES, Batch, Manifest, stage_digest
from scenec.schemas.passes import ANNOTATION, ANNOTATION_NAMES
from scenec.schemas.records import BackendChoice
from scenec.schemas.sidecars import read_sidecar
from scenec.schemas.spelling import nearest


def opening_of(batch: Batch, plan: RenderPlan) -> Opening:
    """Returns the opening of a batch that a worker holds."""
    passes = None if plan.passes is None else tuple(plan.passes)
    stage = os.path.abspath(batch.stage)
    return Opening(stage, plan.backend, plan.device, passes, plan.allow_missing)


def frames_of(
    batch: Batch,
    plan: RenderPlan,
    opened: Opened,
    choice: BackendChoice | None = None,
    passes: Sequence[str] | None = None,
) -> list[RenderFrame]:
    """The frames that a plan asks of a batch, in the order of their samples.

    Args:
        batch: The batch; its folder takes the frames.
        plan: What is asked.
        opened: What its stage holds.
        choice: Why this backend, for sidecars.
        passes: Of these frames; None: all that the stage was opened for.

    Raises:
        StageError: The stage does not hold what is asked for.
        BackendError: A picture is to be denoised that cannot be.
    """
    require_samples(batch, plan.samples, len(opened.cameras))
    who = opened.renderer
    seen = sorted({camera.name for cameras in opened.cameras for camera in cameras})
    unknown = [name for name in plan.cameras or () if name not in seen]
    if unknown:
        raise StageError(f"{batch.stage}: has no camera {unknown[0]!r}{nearest(unknown[0], seen)}")
    for name in seen if plan.cameras is None else plan.cameras:
        # The name is the stage's, and what lies there may be a link.
        stem = frame_stem(batch.folder, who.backend, name, 0)
        inside(batch.folder, stem.relative_to(batch.folder).as_posix(), batch.stage)
    holds = opening_of(batch, plan)
    version = f"{who.version}, {who.denoiser}" if plan.denoise else who.version
    found = []
    for sample, number, camera in _wanted(plan, opened):
        made = tuple(camera.passes if passes is None else passes)
        if not made and plan.passes is None and plan.backend in ANNOTATION_NAMES:
            # For rgb alone: said by ``not_requested``.
            continue
        if not made:
            raise StageError(f"{batch.stage}: no passes asked for, and none in the stage")
        if plan.denoise and "rgb" in made and camera.undenoised:
            raise BackendError(camera.undenoised)
        stem = frame_stem(batch.folder, who.backend, camera.name, sample)
        found.append(
            RenderFrame(
                holds=holds,
                what=f"{batch.name}/{camera.name}/{sample:06d}",
                stem=stem.absolute(),
                sensor=camera.name,
                number=number,
                sample=sample,
                key=plan.key(opened.digest, made, who.backend, version),
                seed=frame_seed(plan.noise_seed, batch.name, camera.name, sample),
                choice=choice,
                replace=plan.replace,
            )
        )
    return found


def may_lose(batch: Batch, plan: RenderPlan, manifest: Manifest | None) -> bool:
    """Tells whether a batch has frames of its stage that a plan could replace and may not.

    Args:
        batch: The batch.
        plan: What is asked.
        manifest: Of the output; None beside a USD file.
    """
    if plan.replace:
        return False
    names = {plan.backend if plan.passes is None or "rgb" in plan.passes else ANNOTATION}
    names |= {ANNOTATION} if plan.passes is None else set()
    digest = None if manifest is None else stage_digest(manifest, batch.name)
    for name in sorted(names):
        for path in (batch.folder / FRAMES / name).glob("*/*.json"):
            with suppress(FrameError):
                if digest in (None, read_sidecar(path).stage_digest):
                    return True
    return False


def require_samples(batch: Batch, samples: Collection[int] | None, count: int) -> None:
    """Refuse samples that a stage of so many does not hold.

    Raises:
        StageError: There is one.
    """
    given = () if samples is None else samples
    beyond = [sample for sample in given if not 0 <= sample < count]
    if beyond:
        raise StageError(f"{batch.stage}: has samples 0 to {count - 1}, not {beyond[0]}")


def _wanted(plan: RenderPlan, opened: Opened) -> Iterator[tuple[int, int, CameraFacts]]:
    """Sample, number of the camera, camera."""
    samples = range(len(opened.cameras)) if plan.samples is None else sorted(plan.samples)
    for sample in samples:
        for number, camera in enumerate(opened.cameras[sample]):
            if camera.fires and (plan.cameras is None or camera.name in plan.cameras):
                yield sample, number, camera


#: What a stage holds only if some camera asked for it, and only what such cameras see.
_PRUNED_BY = ("rgb", "label", "instance")


def not_requested(cameras: Sequence[CameraFacts]) -> Iterator[str]:
    """A line for each camera that is to render what its stage was not compiled for."""
    for camera in cameras:
        if not camera.passes:
            yield (
                f"camera {camera.name} asks for rgb alone: no frame of it is made; --passes says "
                "what it should hold"
            )
        asked = {name.split(".")[0] for name in camera.passes}
        missing = [n for n in _PRUNED_BY if n in asked and n not in camera.outputs]
        if missing:
            yield (
                f"camera {camera.name} did not ask for {', '.join(missing)}: what only that "
                "would show may not be in the stage; compile with that output, or with --keep all"
            )
