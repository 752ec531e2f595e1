"""``scenec check``: files, stages, frames, exactness, and whether backends agree."""

from __future__ import annotations

import argparse
import math
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from scenec.api.text import table
from scenec.backends.check.compare import (
    PICTURES,
    Agreement,
    CompareOptions,
    check_exact,
    compare,
)
from scenec.backends.check.files import check_files
from scenec.backends.check.finding import Finding
from scenec.backends.check.frames import check_frames, check_scans, sensors_found
from scenec.backends.check.radiance import RadianceComparison
from scenec.backends.check.scene import check_scene
from scenec.backends.check.stage import NOT_WHOLE, check_stage
from scenec.backends.check.witness import HAIR_PIXELS
from scenec.backends.registry import require_name
from scenec.backends.stage.read import read_stage
from scenec.cli.output import print_json, say, say_next
from scenec.schemas.errors import ScenecError, StageError
from scenec.schemas.frames import ANNOTATION_NAMES
from scenec.schemas.manifest import find_batches, read_manifest

#: Checks that a stage is whole.
_WHOLE = ("files", "assets", *(f"UsdValidation:{name}" for name in NOT_WHOLE))
#: What makes a folder a dataset, see ``scenec.datasets.export``.
EXPORT = "export.json"


def run(options: argparse.Namespace) -> int:
    """Checks; 1 if something is wrong."""
    if options.against is not None or (Path(options.out) / EXPORT).is_file():
        return _check_dataset(options)
    for name in options.backends:
        require_name(name)
    if options.backends and set(options.backends) <= set(ANNOTATION_NAMES):
        raise ScenecError(
            f"--backends {','.join(options.backends)}: names no renderer; renderers are held "
            "against the annotation"
        )
    out = Path(options.out)
    findings = find(out, options.allow_missing)
    bad = [f for f in findings if f.severity == "error"]
    agreement = exact = None
    # What is there can be compared without what is not.
    if (options.backends or options.exact) and any(f.check != "missing" for f in bad):
        say("frames are not compared before the errors are mended")
    else:
        if options.backends:
            agreement = compare(out, list(dict.fromkeys(options.backends)), say, _how(out, options))
        if options.exact:
            exact = check_exact(out, say, options.allow_missing)
    if options.json:
        print_json(
            {
                "findings": [asdict(f) for f in findings],
                "agreement": None if agreement is None else agreement_json(agreement),
                "exact": None if exact is None else agreement_json(exact),
            }
        )
    else:
        for finding in findings:
            print(finding)
        print(f"{len(bad)} errors, {len(findings) - len(bad)} warnings")
        for found in (agreement, exact):
            if found:
                print_agreement(found)
        if not bad:
            say_next(("view", out), ("export --format coco", out))
    wrong = sum(found.differing for found in (agreement, exact) if found)
    return 1 if bad or wrong else 0


def _check_dataset(options: argparse.Namespace) -> int:
    if options.backends or options.exact:
        raise ScenecError(
            f"{options.out}: --backends and --exact are about the frames of an output folder, not "
            "about datasets or --against"
        )
    # Imported here: what checks stages needs nothing of datasets.
    from scenec.cli import check_dataset

    return check_dataset.run(options)


def _how(out: Path, options: argparse.Namespace) -> CompareOptions:
    return CompareOptions(
        spp=options.spp,
        passes=options.passes,
        samples=options.samples,
        floor=options.floor,
        pictures=(out if out.is_dir() else out.parent) / PICTURES if options.pictures > 0 else None,
        most_pictures=options.pictures,
        allow_missing=options.allow_missing,
    )


def find(out: Path, allow_missing: bool = False) -> list[Finding]:
    """All findings on an output folder or a stage.

    Args:
        out: Output folder, or a USD file.
        allow_missing: Whether what is missing is a warning.
    """
    findings: list[Finding] = []
    if out.is_dir():
        findings.extend(check_files(out, read_manifest(out)))
    batches = find_batches(out)
    found = sensors_found(batches) if out.is_dir() else None
    for batch in batches:
        findings.extend(check_stage(batch.stage))
        digest = firing = scanning = None
        try:
            scene = read_stage(batch.stage, allow_missing=allow_missing)
            findings.extend(check_scene(scene))
            digest = scene.digest
            if out.is_dir():
                # Beside a USD file there may be the frames of another.
                firing = [[(c.name, c.fires(i)) for c in of] for i, of in enumerate(scene.cameras)]
                # Lidars of a sample are those that scan at it.
                scanning = [[(lidar.name, True) for lidar in some] for some in scene.lidars]
        except StageError as error:
            findings.append(Finding("reader", "error", batch.name, str(error)))
        findings.extend(check_frames(batch.folder, digest, firing, found))
        findings.extend(check_scans(batch.folder, digest, scanning, found))
    if allow_missing:
        findings = [replace(f, severity="warning") if f.check in _WHOLE else f for f in findings]
    return findings


def agreement_json(agreement: Agreement) -> dict[str, Any]:
    """For scripts; what is unknown is null."""
    return {
        "frames": agreement.frames,
        "comparisons": [asdict(c) for c in agreement.comparisons],
        "witnesses": {name: asdict(found) for name, found in agreement.witnesses.items()},
        "radiance": [
            {
                "first": r.first,
                "second": r.second,
                "frames": r.frames,
                "mean_ratio": r.mean_ratio,
                "relative_mse": _known(r.relative_mse),
                "noise_relative_mse": _known(r.noise),
                "flip": _known(r.flip),
                "flip_floor": _known(r.floor),
            }
            for r in agreement.radiance
        ],
        "pictures": [str(path) for path in agreement.pictures],
    }


def _known(values: list[float]) -> list[float | None]:
    return [None if math.isnan(value) else value for value in values]


def print_agreement(agreement: Agreement) -> None:
    """Tables: annotation on disk, what renderers themselves see, radiance."""
    rows = [
        [c.backend, c.channel, f"{c.differing:,}", f"{c.pixels:,}"] for c in agreement.comparisons
    ]
    if rows:
        print(f"\nannotation of {agreement.frames} frames against the exact caster:")
        print(table(rows, ["backend", "channel", "differing", "pixels"]))
    seen = [
        [name, f"{w.differing:,}", f"{w.farthest_px:.2g}", f"{w.beyond:,}", f"{w.pixels:,}"]
        for name, w in agreement.witnesses.items()
    ]
    if seen:
        print("\nwhat renderers themselves see, against the exact caster:")
        header = ["backend", "other face", "farthest, px", f"beyond {HAIR_PIXELS:.3g} px", "pixels"]
        print(table(seen, header))
    for name, witness in agreement.witnesses.items():
        if witness.unseen:
            print(f"{name} does not tell what it sees of {witness.unseen} frames")
    if agreement.radiance:
        print("\nradiance of surfaces (rgb):")
        header = ["backends", "mean ratio R", "G", "B", "relMSE", "of it noise", "FLIP", "floor"]
        print(table([_radiance_row(r) for r in agreement.radiance], header))
        if any(math.isnan(v) for r in agreement.radiance for v in r.flip):
            print("FLIP is not installed; mend it with: pip install 'scenec[flip]'")
    if agreement.pictures:
        print(f"\nwhere they differ: {len(agreement.pictures)} pictures in "
              f"{agreement.pictures[0].parent}/")  # fmt: skip


def _radiance_row(r: RadianceComparison) -> list[str]:
    ratios = ["-" if ratio is None else f"{ratio:.4f}" for ratio in r.mean_ratio]
    numbers = [_mean(r.relative_mse), _mean(r.noise), _mean(r.flip), _mean(r.floor)]
    return [f"{r.first} : {r.second}", *ratios, *numbers]


def _mean(values: list[float]) -> str:
    if not values:
        return "-"
    mean = sum(values) / len(values)
    return "unknown" if math.isnan(mean) else f"{mean:.3g}"
