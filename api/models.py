"""Stages as files of 3D formats: glTF and USDZ."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from scenec.api.options import ExportOptions
from scenec.backends.model.collect import full_model
from scenec.backends.stage.read import read_stage
from scenec.datasets.models import TEXELS
from scenec.datasets.models.gltf import ModelContent, write_gltf
from scenec.datasets.models.usdz import write_usdz
from scenec.schemas.codec import JsonObject
from scenec.schemas.errors import OutputError
from scenec.schemas.files import atomic, sha256
from scenec.schemas.manifest import Batch, find_batches
from scenec.schemas.versions import version_of

#: Options that choose among frames.
_OF_FRAMES = (
    *("backend", "cameras", "samples", "keep", "rejected", "remap", "level", "split"),
    *("rectify", "cluster"),
)
_ENDINGS = {"gltf": ".glb", "usdz": ".usdz"}
#: Most texels that may be asked for.
_MOST_TEXELS = 1 << 28


@dataclass(frozen=True)
class ModelsReport:
    """Reports an export of stages.

    Attributes:
        folder: Of the files.
        format: Their format.
        files: One a batch; of maps all of them.
        content: What ``export.json`` beside them says.
    """

    folder: Path
    format: str
    files: tuple[Path, ...]
    content: JsonObject

    @property
    def losses(self) -> tuple[str, ...]:
        """A line for each thing that the format cannot hold."""
        lines = (line for one in self.content["batches"].values() for line in one["losses"])
        return tuple(dict.fromkeys(lines))


def export_models(out: Path, format: str, options: ExportOptions) -> ModelsReport:
    """Writes a file a batch, and ``export.json`` about them.

    Args:
        out: Output folder of a compile, or a USD file.
        format: ``gltf`` or ``usdz``.
        options: Those that choose among frames must not be set.

    Raises:
        OutputError: An option makes no sense, or a file is there already.
    """
    texels = _texels(options.settings)
    batches = chosen_batches(out, format, options)
    folder = dataset_folder(out, format, options)
    files = {b.name: folder / f"{b.name}{_ENDINGS[format]}" for b in batches}
    for file in files.values():
        if file.exists() and not options.replace:
            raise OutputError(f"{file}: is there already; --replace writes it anew")
    folder.mkdir(parents=True, exist_ok=True)
    steps = options.listener.steps("exported", unit="batch", units="batches")
    contents: dict[str, dict[str, Any]] = {}
    for number, batch in enumerate(batches):
        written = _write(format, batch, files[batch.name], texels)
        contents[batch.name] = {
            "file": files[batch.name].name,
            "bytes": files[batch.name].stat().st_size,
            "sha256": sha256(files[batch.name]),
            "triangles": written.triangles,
            "instances": written.instances,
            "losses": list(written.losses),
        }
        steps(number + 1, len(batches), batch.name)
    report = {"format": format, "scenec": version_of(), "batches": contents}
    with atomic(folder / "export.json") as temporary:
        temporary.write_text(json.dumps(report, indent=2) + "\n", encoding="utf-8")
    return ModelsReport(folder, format, tuple(files.values()), report)


def chosen_batches(out: Path, format: str, options: ExportOptions) -> list[Batch]:
    """The batches that are asked for, of a format that holds stages.

    Raises:
        OutputError: There are none, or options choose among frames.
    """
    usual = ExportOptions()
    for name in _OF_FRAMES:
        if (name != "cluster" or format in _ENDINGS) and getattr(options, name) not in (
            getattr(usual, name),
            [],
        ):
            raise OutputError(
                f"--{name} chooses among frames, and {format} holds stages; leave it out"
            )
    batches = [
        batch
        for batch in find_batches(out)
        if options.batches is None or batch.index in options.batches
    ]
    if not batches:
        raise OutputError(f"{out}: no such batches; scenec compile makes some")
    return batches


def dataset_folder(out: Path, format: str, options: ExportOptions) -> Path:
    """The folder that a dataset of an output goes to."""
    base = out if out.is_dir() else out.parent
    return Path(options.folder) if options.folder else base / "datasets" / format


def _texels(settings: Sequence[str]) -> int:
    texels = TEXELS
    for text in settings:
        name, _, value = text.partition("=")
        if name.strip() != "texels":
            raise OutputError(f"--set {text!r}: the only option here is texels=N")
        if not value.strip().isdecimal() or not 1 <= int(value) <= _MOST_TEXELS:
            raise OutputError(f"--set {text!r}: expected a whole number from 1 to {_MOST_TEXELS}")
        texels = int(value)
    return texels


def _write(name: str, batch: Batch, file: Path, texels: int) -> ModelContent:
    model = full_model(read_stage(batch.stage), batch.name, texels=texels)
    if name == "gltf":
        return write_gltf(model, file)
    return write_usdz(model, batch.stage, file)
