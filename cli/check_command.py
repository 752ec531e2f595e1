"""``scenec check``: files, stages, frames, and whether backends agree."""

from __future__ import annotations

import argparse
from dataclasses import asdict
from pathlib import Path

from scenec.backends.check.compare import Agreement, compare
from scenec.backends.check.files import check_files
from scenec.backends.check.finding import Finding
from scenec.backends.check.frames import check_frames
from scenec.backends.check.stage import check_stage
from scenec.backends.reader import read_stage
from scenec.backends.registry import require_name
from scenec.cli.output import print_json, say, table
from scenec.schemas.errors import ScenecError, StageError
from scenec.schemas.manifest import find_batches, read_manifest


def run(options: argparse.Namespace) -> int:
    """Checks; 1 if something is wrong."""
    for name in options.backends:
        require_name(name)
    if options.backends and len(set(options.backends)) < 2:
        raise ScenecError(f"--backends {','.join(options.backends)}: comparing takes two or more")
    out = Path(options.out)
    findings = find(out)
    bad = [f for f in findings if f.severity == "error"]
    agreement = None
    if options.backends and bad:
        say("backends are not compared before the errors are mended")
    elif options.backends:
        agreement = compare(out, options.backends, say)
    differing = sum(c.differing for c in agreement.comparisons) if agreement else 0
    if options.json:
        print_json(
            {
                "findings": [asdict(f) for f in findings],
                "agreement": None if agreement is None else asdict(agreement),
            }
        )
    else:
        for finding in findings:
            print(finding)
        print(f"{len(bad)} errors, {len(findings) - len(bad)} warnings")
        if agreement:
            print_agreement(agreement)
    return 1 if bad or differing else 0


def find(out: Path) -> list[Finding]:
    """All findings on an output folder or a stage."""
    findings: list[Finding] = []
    if out.is_dir():
        findings.extend(check_files(out, read_manifest(out)))
    for batch in find_batches(out):
        findings.extend(check_stage(batch.stage))
        digest = None
        try:
            digest = read_stage(batch.stage).digest
        except StageError as error:
            findings.append(Finding("reader", "error", batch.name, str(error)))
        findings.extend(check_frames(batch.folder, digest))
    return findings


def print_agreement(agreement: Agreement) -> None:
    """Differing pixels of resolved annotation, and what the renderers themselves had wrong."""
    rows = [
        [f"{c.first} : {c.second}", c.channel, f"{c.differing:,}", f"{c.pixels:,}"]
        for c in agreement.comparisons
    ]
    print(f"annotation of {agreement.frames} frames, resolved:")
    print(table(rows, ["backends", "channel", "differing", "pixels"]))
    for backend, pixels in agreement.raw.items():
        print(f"{backend}: {pixels:,} pixels were wrong before they were resolved")
