"""Stages and frames that show themselves in a notebook."""

from __future__ import annotations

import base64
import html
import io
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from scenec.api.declare import require
from scenec.backends.annotation.annotate import annotate
from scenec.backends.exact import ExactCaster
from scenec.backends.stage.read import read_stage
from scenec.backends.stage.scene import Camera, RenderScene
from scenec.datasets import pictures
from scenec.datasets.colors import label_colors, paint_depth, paint_instances, paint_labels
from scenec.datasets.source import FrameRef, LoadedFrame, Source
from scenec.schemas.codec import JsonObject
from scenec.schemas.manifest import REPORT, Batch, find_batches
from scenec.schemas.records import FrameRecord
from scenec.schemas.report import BatchReport, read_output_record
from scenec.schemas.spelling import nearest, shown

#: Pixels that a shown picture is wide at most.
_WIDE = 480


@dataclass(frozen=True)
class StageView:
    """A compiled batch, or any USD stage: ``StageView.of("scene.usda")``.

    Attributes:
        batch: Where it is.
    """

    batch: Batch

    @classmethod
    def of(cls, path: Path | str) -> StageView:
        """A stage by its root layer."""
        require("path", path, "Path | str")
        return cls(find_batches(Path(path))[0])

    @cached_property
    def scene(self) -> RenderScene:
        """Reads the stage as flat arrays.

        Raises:
            StageError: It cannot be read.
        """
        return read_stage(self.batch.stage)

    @property
    def cameras(self) -> Sequence[Camera]:
        """Its cameras at the first sample."""
        return self.scene.cameras[0]

    def sketch(self, camera: int = 0, sample: int = 0, width: int = _WIDE) -> NDArray[np.uint8]:
        """Draws a camera's view: label colors, shaded by the angle to the view; uint8 [h, w, 3].

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
        arrays = annotate(scene, self.caster, seen, names, sample).arrays
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
    def caster(self) -> ExactCaster:
        """Its exact caster, built when it is first asked for."""
        return ExactCaster(self.scene)

    def _repr_html_(self) -> str:
        rows: dict[str, Any] = {"stage": str(self.batch.stage)}
        report = self.batch.folder / REPORT
        if report.is_file():
            told = read_output_record(report, BatchReport)
            rows["terrain"] = f"{told.ground.faces:,} faces"
            rows |= {name: f"{entry.count:,}" for name, entry in told.objects.items()}
        rows["cameras"] = ", ".join(camera.name for camera in self.cameras)
        rows["samples"] = len(self.scene.cameras)
        shown = "".join(picture_html(self.sketch(i)) for i in range(min(len(self.cameras), 4)))
        return table_html(rows) + shown


@dataclass(frozen=True)
class FrameView:
    """A frame; it is read when it is first looked at.

    Attributes:
        source: The output it is of.
        ref: Which one it is.
    """

    source: Source
    ref: FrameRef

    @cached_property
    def loaded(self) -> LoadedFrame:
        """Loads the frame.

        Raises:
            FrameError: It is damaged, or of another stage.
        """
        return self.source.load(self.ref)

    def __getitem__(self, name: str) -> NDArray[Any]:
        """A pass by name: ``rgb``, ``depth`` and so on.

        Raises:
            KeyError: The frame has none of this name; says which it has.
        """
        if name not in self.loaded.passes:
            raise KeyError(f"{self.ref.key} has no pass {shown(name)}{nearest(name, self.passes)}")
        return self.loaded.passes[name]

    @property
    def passes(self) -> tuple[str, ...]:
        """Names of its passes."""
        return tuple(self.loaded.passes)

    @property
    def sidecar(self) -> FrameRecord:
        """Says what its JSON sidecar does of intrinsics, pose, labels, errors and times."""
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
        error = frame.sidecar.error.relative_rms
        rows = {
            "frame": frame.ref.name,
            "made by": frame.sidecar.backend_version or "",
            "passes": ", ".join(frame.passes),
        }
        if error is not None:
            rows["error"] = f"{100.0 * error:.2g} %"
        return table_html(rows) + "".join(picture_html(one) for one in shown)


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


def picture_html(pixels: NDArray[np.uint8], width: int = _WIDE) -> str:
    """A picture, uint8 [h, w, 3], as HTML that holds it; ``width`` is of the page's pixels."""
    data = io.BytesIO()
    Image.fromarray(pixels).save(data, "PNG")
    text = base64.b64encode(data.getvalue()).decode()
    return f'<img width="{min(width, pixels.shape[1])}" src="data:image/png;base64,{text}">'


def table_html(rows: JsonObject) -> str:
    """A table of names and values as HTML."""
    cells = "".join(
        f"<tr><th style='text-align:left'>{html.escape(key)}</th>"
        f"<td style='text-align:left'>{html.escape(str(value))}</td></tr>"
        for key, value in rows.items()
    )
    return f"<table>{cells}</table>"
