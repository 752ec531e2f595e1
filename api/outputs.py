"""Outputs, stages and frames, which show themselves in a notebook.

import scenec
from scenec.compiler.cfg.builder import Cfg, ...

output = scenec.compile(Cfg(...), "OUT", seed=1)
output.stages[0]                      # a sketch of what each camera sees, without a renderer
output.render("mitsuba", spp=16)      # the contact sheet
output.frames()[0]["depth"]           # arrays
"""

from __future__ import annotations

import base64
import html
import io
import json
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from scenec.backends.annotation.annotate import annotate
from scenec.backends.exact import ExactCaster
from scenec.backends.run.executors import make_executor
from scenec.backends.run.render import render
from scenec.backends.stage.read import read_stage
from scenec.backends.stage.scene import Camera, RenderScene
from scenec.compiler.cfg.builder import CompleteCfg
from scenec.compiler.compile import compile_cfg
from scenec.datasets import pictures
from scenec.datasets.colors import label_colors, paint_depth, paint_instances, paint_labels
from scenec.datasets.sheet import write_sheet
from scenec.datasets.source import LoadedFrame, Source
from scenec.schemas.errors import FrameError
from scenec.schemas.manifest import REPORT, Batch, find_batches, read_manifest
from scenec.schemas.scratch import scratch_folder

#: Pixels that a shown picture is wide at most.
_WIDE = 480


def compile(
    cfg: CompleteCfg | Path | str, out: Path | str, seed: int = 0, **options: Any
) -> Output:
    """Compile a cfg.

    Args:
        cfg: Written in Python (``scenec.compiler.cfg.builder``), or a file. Files that the former
            names are relative to the working directory.
        out: Output folder.
        seed: As of ``compile_cfg``.
        options: Further ones of ``compile_cfg``.

    Raises:
        CfgError, SceneError, OutputError: As of ``compile_cfg``.
    """
    # Said of no file: faults have JSON pointers.
    given = cfg.check() if isinstance(cfg, CompleteCfg) else cfg
    compile_cfg(given, seed=seed, out=out, **options)
    return Output(out)


class Output:
    """An output folder.

    Args:
        path: Where it is.

    Raises:
        OutputError: It is none.
    """

    def __init__(self, path: Path | str) -> None:
        self.path = Path(path)
        read_manifest(self.path)

    @property
    def stages(self) -> list[Stage]:
        """The stage of each batch."""
        return [Stage(batch) for batch in find_batches(self.path)]

    def render(self, backend: str = "auto", *, workers: int = 0, **options: Any) -> Output:
        """Render what is not rendered yet; returns itself.

        Args:
            backend: Name of a backend; ``annotation`` makes all but pictures.
            workers: Processes that render; 0: one of its own.
            options: Fields of ``scenec.backends.run.plan.RenderPlan``: ``spp``, ``passes``, …

        Raises:
            StageError, BackendError, OutputError: As of ``scenec.backends.run.render.render``.
            FrameError: A frame could not be made.
        """
        with ExitStack() as stack:
            executor = stack.enter_context(make_executor(workers, None)) if workers else None
            report = render(self.path, backend, executor=executor, **options)
        if report.failed:
            raise FrameError("; ".join(report.failed))
        return self

    def frames(self, backend: str | None = None) -> list[Frame]:
        """Frames that are there, by batch, camera and sample.

        Args:
            backend: Whose; None takes the first that there is.

        Raises:
            FrameError: There are none.
        """
        source = Source(self.path, backend)
        return [Frame(source.load(ref)) for ref in source.frames]

    def _repr_html_(self) -> str:
        manifest = read_manifest(self.path)
        rows = {
            "output": str(self.path),
            "cfg": manifest.get("name", ""),
            "seed": manifest.get("seed", ""),
            "batches": len(manifest["batches"]),
            "made by": f"scenec {manifest.get('scenec', '')}",
        }
        try:
            with scratch_folder() as folder:
                sheet = write_sheet(self.path, Path(folder) / "sheet.png", count=3)
                with Image.open(sheet.path) as picture:
                    shown = _picture(np.asarray(picture.convert("RGB")), picture.width)
        except FrameError:
            shown = "".join(stage._repr_html_() for stage in self.stages[:3])
        return _table(rows) + shown


@dataclass(frozen=True)
class Stage:
    """A compiled batch, or any USD stage: ``Stage.of("scene.usda")``.

    Attributes:
        batch: Where it is.
    """

    batch: Batch

    @classmethod
    def of(cls, path: Path | str) -> Stage:
        """A stage by its root layer."""
        return cls(find_batches(Path(path))[0])

    @cached_property
    def scene(self) -> RenderScene:
        """What it holds, as flat arrays.

        Raises:
            StageError: It cannot be read.
        """
        return read_stage(self.batch.stage)

    @property
    def cameras(self) -> Sequence[Camera]:
        """Its cameras at the first sample."""
        return self.scene.cameras[0]

    def sketch(self, camera: int = 0, sample: int = 0, width: int = _WIDE) -> NDArray[np.uint8]:
        """What a camera sees: label colors, shaded by the angle to the view; uint8 [h, w, 3].

        First hits of the exact caster, no renderer.

        Args:
            camera: Its index.
            sample: Time code.
            width: Pixels at most.
        """
        scene = self.scene
        seen = _smaller(scene.cameras[sample][camera], width)
        level = next(iter(scene.levels), None)
        names = ["normal", "position", *([f"label.{level}"] if level else [])]
        arrays = annotate(scene, self._caster, seen, names, sample).arrays
        to_eye = seen.camera_to_world[:3, 3] - arrays["position"]
        length = np.sqrt((to_eye * to_eye).sum(axis=-1))
        light = np.abs((to_eye * arrays["normal"]).sum(axis=-1)) / length
        colors = np.full((*light.shape, 3), 200.0)
        if level:
            ids = arrays[f"label.{level}"]
            known = sorted(scene.label_names.get(level, {}))
            colors = paint_labels(ids, label_colors(known)).astype(np.float64)
        shade = np.where(np.isfinite(light), 0.35 + 0.65 * light, 1.0)
        return np.round(colors * shade[..., None]).astype(np.uint8)

    @cached_property
    def _caster(self) -> ExactCaster:
        return ExactCaster(self.scene)

    def _repr_html_(self) -> str:
        rows: dict[str, Any] = {"stage": str(self.batch.stage)}
        report = self.batch.folder / REPORT
        if report.is_file():
            facts = json.loads(report.read_bytes())
            rows["terrain"] = f"{facts['ground']['faces']:,} faces"
            for name, entry in facts.get("objects", {}).items():
                rows[name] = f"{entry['count']:,}"
        rows["cameras"] = ", ".join(camera.name for camera in self.cameras)
        rows["samples"] = len(self.scene.cameras)
        shown = "".join(_picture(self.sketch(i)) for i in range(min(len(self.cameras), 4)))
        return _table(rows) + shown


@dataclass(frozen=True)
class Frame:
    """A frame.

    Attributes:
        loaded: What was read.
    """

    loaded: LoadedFrame

    def __getitem__(self, name: str) -> NDArray[Any]:
        """A pass by name: ``rgb``, ``depth`` and so on.

        Raises:
            KeyError: The frame has none of this name.
        """
        return self.loaded.passes[name]

    @property
    def passes(self) -> tuple[str, ...]:
        """Names of its passes."""
        return tuple(self.loaded.passes)

    @property
    def sidecar(self) -> Mapping[str, Any]:
        """Intrinsics, pose, labels, errors, times: what its JSON sidecar says."""
        return self.loaded.sidecar

    @property
    def picture(self) -> NDArray[np.uint8]:
        """The 8-bit picture, uint8 [h, w, 3].

        Raises:
            FrameError: It was rendered without ``rgb``.
        """
        return pictures.picture(self.loaded)

    def _repr_html_(self) -> str:
        frame = self.loaded
        shown = [self.picture] if pictures.has_picture(frame) else []
        for level, names in frame.labels.items():
            if f"label.{level}" in frame.passes:
                ids = frame.passes[f"label.{level}"]
                shown.append(paint_labels(ids, label_colors(list(names))))
        if "instance" in frame.passes:
            shown.append(paint_instances(frame.passes["instance"]))
        depth = frame.passes.get("depth")
        if depth is not None and np.isfinite(depth).any():
            near, far = np.percentile(depth[np.isfinite(depth)], [1, 99])
            shown.append(paint_depth(depth, float(near), float(far)))
        error = frame.sidecar.get("estimated_error") or {}
        rows = {
            "frame": frame.ref.name,
            "made by": frame.sidecar.get("backend_version", ""),
            "passes": ", ".join(frame.passes),
        }
        if error.get("relative_rms") is not None:
            rows["error"] = f"{100.0 * error['relative_rms']:.2g} %"
        return _table(rows) + "".join(_picture(one) for one in shown)


def _smaller(camera: Camera, width: int) -> Camera:
    """A camera with fewer pixels that sees the same."""
    if camera.width <= width:
        return camera
    factor = width / camera.width
    height = max(1, round(camera.height * factor))
    intrinsics = camera.intrinsics.copy()
    intrinsics[0] *= factor
    intrinsics[1] *= height / camera.height
    return replace(camera, width=width, height=height, intrinsics=intrinsics)


def _picture(pixels: NDArray[np.uint8], width: int = _WIDE) -> str:
    data = io.BytesIO()
    Image.fromarray(pixels).save(data, "PNG")
    text = base64.b64encode(data.getvalue()).decode()
    return f'<img width="{min(width, pixels.shape[1])}" src="data:image/png;base64,{text}">'


def _table(rows: Mapping[str, Any]) -> str:
    cells = "".join(
        f"<tr><th style='text-align:left'>{html.escape(key)}</th>"
        f"<td style='text-align:left'>{html.escape(str(value))}</td></tr>"
        for key, value in rows.items()
    )
    return f"<table>{cells}</table>"
