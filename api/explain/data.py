"""Reads the inputs of ``scenec explain``: reports, timings, sidecars of frames."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from scenec.schemas.errors import OutputError
from scenec.schemas.manifest import FRAMES, REPORT, TIMINGS, find_batches, read_manifest
from scenec.schemas.shape import Each, natural, read_shaped, require_shape
from scenec.schemas.sidecars import read_sidecar

_FINER = {
    "surface_error_rms_px": float,
    "checked_points": natural,
    "searched_points?": natural,
    "finest_leg_m": float,
}
_MESH = {
    "triangles": natural,
    "triangles_of_grid": natural,
    "tolerance_px": float,
    "tolerance_reached_px": float,
    "budget_bound": bool,
    "height_error_max_px": float,
    "label_error_max_px?": float,
    # Older outputs have the first.
    "finer?": (None, _FINER | {"surface_error_max_px": float},
               _FINER | {"surface_error_found_px": float})
}  # fmt: skip
_CONDITION = {"type": str, "holds": float, "smoothed_over_m?": (None, float)}
_CLASS = {
    "count": natural,
    "asked_for?": natural,
    "triangles": natural,
    "triangles_finest?": natural,
    "lod_px?triangles_finest": float,
    "lod_error_max_px?triangles_finest": float,
    "gap_max_px?": float,
    "float_max_m?gap_max_px": float,
    "sink_max_m?gap_max_px": float,
    "seating_error_max_m?": float,
    "moved_off_cameras?": natural,
    "float32_error_max_m": float,
    "left_out?": [str],
    "levels?": Each({"error": float}),
}
_TEXELS = [natural, natural]
_PICTURE = {
    "texels": _TEXELS,
    "texels_per_pixel": float,
    "texels_kept?": _TEXELS,
    "rms_error?texels_kept": float,
    "slope_rms_kept?": float,
    "slope_rms?slope_rms_kept": float,
    "bytes_saved?": float,
    "texels_kept?bytes_saved": _TEXELS,
}
_REPORT = {
    "bytes": natural,
    "relief": [{"type": str}],
    "cover?": [{"layer": natural, "covers": float, "shows": float, "conditions": [_CONDITION]}],
    "ground": {
        "faces": natural,
        "float32_error_max_m": float,
        "mesh?": (None, _MESH),
        "cuts": [dict.fromkeys(("chord_error_rms_m", "chord_error_max_m", "snap_max_m"), float)]
    },
    "objects?": Each(_CLASS),
    "object_budget?": (None, {"max_triangles": natural, "error_factor": float}),
    "precision?": {
        "promised_m": float,
        "promised_px": (None, float),
        "float32_error_max_m": float,
        "float32_error_max_px": (None, float)
    },
    "sky?": Each({"resolution_error?": float}),
    "surfaces?": Each({"pictures?": Each(_PICTURE)}),
    "motion?": Each(dict),
    "prune?": (None, {
        "light?": (None, {"min_view_factor?": float, "everywhere?": bool}),
        "tiles?": {"kept": natural, "of": natural},
        "objects?": Each(Each(natural))
    }),
    "left_out?": [{"what": str, "why": str, "instances?": natural, "triangles?": natural,
                   "bytes?": (None, natural)}]
}  # fmt: skip
_SET_TO_ZERO = {"sky?": {"set_to_zero?": Each({"negative_fraction": float})}}
_TIMINGS = {"compile?": Each(Each(float))}


@dataclass(frozen=True)
class FrameTimes:
    """Holds the times of one backend's frames.

    Attributes:
        backend: Its name.
        frames: How many there are.
        seconds: Per step, of all frames together.
        error: Mean of their estimated errors of ``rgb``, relative; None where it is not known.
    """

    backend: str
    frames: int
    seconds: dict[str, float]
    error: float | None


@dataclass(frozen=True)
class BatchData:
    """One batch, as it was compiled and rendered.

    Attributes:
        name: Of its folder.
        folder: Its folder.
        stage: Its root layer.
        report: report.json.
        seconds: Of each pass of the compilation; empty where they are not known.
        frames: By backend, in alphabetical order.
    """

    name: str
    folder: Path
    stage: Path
    report: dict[str, Any]
    seconds: dict[str, float]
    frames: tuple[FrameTimes, ...] = field(default=())


def read_batches(out: Path, batches: Collection[int] | None = None) -> list[BatchData]:
    """The batches of an output folder.

    Args:
        out: Output folder of a compile.
        batches: Only these; None takes all.

    Raises:
        OutputError: No manifest, or a file that is damaged.
        StageError: A batch that is not there.
    """
    read_manifest(out)
    path = out / TIMINGS
    timings = _read(path, _TIMINGS).get("compile", {}) if path.is_file() else {}
    return [
        BatchData(
            batch.name,
            batch.folder,
            batch.stage,
            _read(batch.folder / REPORT, _REPORT, _SET_TO_ZERO),
            timings.get(batch.name, {}),
            tuple(_frames(batch.folder)),
        )
        for batch in find_batches(out, batches)
    ]


def _frames(folder: Path) -> list[FrameTimes]:
    found = []
    for backend in sorted(path for path in (folder / FRAMES).glob("*") if path.is_dir()):
        records = [read_sidecar(path) for path in sorted(backend.glob("*/*.json"))]
        if not records:
            continue
        seconds: dict[str, float] = {}
        errors = []
        for record in records:
            for step, value in (record.seconds or {}).items():
                seconds[step] = seconds.get(step, 0.0) + value
            if record.error.relative_rms is not None:
                errors.append(record.error.relative_rms)
        mean = sum(errors) / len(errors) if errors else None
        found.append(FrameTimes(backend.name, len(records), seconds, mean))
    return found


def _read(path: Path, *shapes: dict[str, Any]) -> dict[str, Any]:
    what = "report of scenec"
    try:
        value: dict[str, Any] = read_shaped(path, dict, OutputError, what)
    except FileNotFoundError as error:
        raise OutputError(f"{path}: cannot be read: {error.strerror}") from error
    for shape in shapes:
        require_shape(value, shape, OutputError, f"{path}: is no {what}")
    return value
