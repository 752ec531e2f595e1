"""``scenec export`` to formats of stages: glTF and USDZ."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

from scenec.backends.model.collect import whole_model
from scenec.backends.stage.read import read_stage
from scenec.cli.output import Progress, print_json, say, say_next
from scenec.datasets.models import TEXELS
from scenec.datasets.models.gltf import Written, write_gltf
from scenec.datasets.models.usdz import write_usdz
from scenec.schemas.errors import OutputError
from scenec.schemas.files import atomic, sha256
from scenec.schemas.manifest import Batch, find_batches
from scenec.schemas.versions import version_of

#: Options that choose among frames, and what they are where nobody set them.
_OF_FRAMES: dict[str, object] = {
    "backend": None,
    "cameras": None,
    "samples": None,
    "keep": [],
    "rejected": "drop",
    "remap": None,
    "level": None,
    "split": None,
    "cluster": None,
}
_ENDINGS = {"gltf": ".glb", "usdz": ".usdz"}
#: Most texels that may be asked for.
_MOST_TEXELS = 1 << 28


def run(options: argparse.Namespace) -> int:
    """Writes a file a batch, and ``export.json`` about them.

    Raises:
        OutputError: An option makes no sense, or a file is there already.
    """
    for name, default in _OF_FRAMES.items():
        if getattr(options, name) != default:
            raise OutputError(
                f"--{name} chooses among frames, and {options.format} holds stages; leave it out"
            )
    texels = _texels(options.set)
    out = Path(options.out)
    batches = [
        batch
        for batch in find_batches(out)
        if options.batches is None or batch.index in options.batches
    ]
    if not batches:
        raise OutputError(f"{out}: no such batches; scenec compile makes some")
    base = out if out.is_dir() else out.parent
    folder = Path(options.output) if options.output else base / "datasets" / options.format
    files = {b.name: folder / f"{b.name}{_ENDINGS[options.format]}" for b in batches}
    for file in files.values():
        if file.exists() and not options.replace:
            raise OutputError(f"{file}: is there already; --replace writes it anew")
    folder.mkdir(parents=True, exist_ok=True)
    progress = Progress("exported", unit="batch", units="batches")
    told: dict[str, dict[str, Any]] = {}
    for number, batch in enumerate(batches):
        written = _write(options.format, batch, files[batch.name], texels)
        told[batch.name] = {
            "file": files[batch.name].name,
            "bytes": files[batch.name].stat().st_size,
            "sha256": sha256(files[batch.name]),
            "triangles": written.triangles,
            "instances": written.instances,
            "losses": list(written.losses),
        }
        progress(number + 1, len(batches), batch.name)
    report = {"format": options.format, "scenec": version_of(), "batches": told}
    with atomic(folder / "export.json") as temporary:
        temporary.write_text(json.dumps(report, indent=2) + "\n", encoding="utf-8")
    if options.json:
        print_json({"folder": str(folder), **report})
    losses = dict.fromkeys(line for one in told.values() for line in one["losses"])
    for line in losses:
        say(f"not in it: {line}")
    for file in files.values():
        say(f"{options.format}: {file} ({file.stat().st_size / 1e6:.1f} MB)")
    say_next(("explain", options.out))
    return 0


def _texels(settings: list[str]) -> int:
    texels = TEXELS
    for text in settings:
        name, _, value = text.partition("=")
        if name.strip() != "texels":
            raise OutputError(f"--set {text!r}: the only option here is texels=N")
        if not value.strip().isdecimal() or not 1 <= int(value) <= _MOST_TEXELS:
            raise OutputError(f"--set {text!r}: expected a whole number from 1 to {_MOST_TEXELS}")
        texels = int(value)
    return texels


def _write(name: str, batch: Batch, file: Path, texels: int) -> Written:
    model = whole_model(read_stage(batch.stage), batch.name, texels=texels)
    if name == "gltf":
        return write_gltf(model, file)
    return write_usdz(model, batch.stage, file)
