"""All lidar scans of an output: no renderer is needed."""

from __future__ import annotations

import time
from collections.abc import Callable, Collection
from dataclasses import dataclass, field
from pathlib import Path

from scenec.backends.annotation.lidar import scan
from scenec.backends.exact import ExactCaster
from scenec.backends.run.writer import plain
from scenec.backends.stage.read import read_stage
from scenec.backends.stage.scene import Lidar, RenderScene
from scenec.schemas.errors import StageError
from scenec.schemas.files import check_writable, inside, sweep
from scenec.schemas.manifest import find_batches
from scenec.schemas.scans import SCANS, is_scanned, scan_key, scan_stem, write_scan
from scenec.schemas.spelling import nearest
from scenec.schemas.strays import Stray, stray_scans, told
from scenec.schemas.update import reading
from scenec.schemas.versions import version_of


@dataclass
class ScanReport:
    """What came of it.

    Attributes:
        scans: Paths of all scans asked for, without suffix.
        made: How many were made now; the others were there.
        seconds: Per step (read, load, scan, write), summed.
        warnings: Lines a user should see.
    """

    scans: list[Path] = field(default_factory=list)
    made: int = 0
    seconds: dict[str, float] = field(
        default_factory=lambda: dict.fromkeys(("read", "load", "scan", "write"), 0.0)
    )
    warnings: list[str] = field(default_factory=list)


def scan_output(
    out: Path | str,
    *,
    samples: Collection[int] | None = None,
    batches: Collection[int] | None = None,
    lidars: Collection[str] | None = None,
    ply: bool = False,
    allow_missing: bool = False,
    progress: Callable[[int, int, str], None] | None = None,
) -> ScanReport:
    """Scan to ``<batch>/scans/<rig>_<lidar>/<sample>.{npz,json}``; see ``schemas.scans``.

    Scans that are there and were made from the same stage are not made again.

    Args:
        out: Output folder of a compile, or a USD file.
        samples: Only these time codes.
        batches: Only these batches.
        lidars: Only these, by name (``<rig>_<lidar>``).
        ply: Whether to write clouds of points beside the arrays.
        allow_missing: Whether to scan what is there of a stage that is not whole; sidecars then say
            what was missing, under ``losses``.
        progress: Called after each scan with done, total of the batch, and its name.

    Raises:
        StageError: A stage cannot be read or is not whole, or no stage has what is asked for.
        OutputError: A file cannot be written.
    """
    with reading(Path(out)):
        return _scan_batches(out, samples, batches, lidars, ply, allow_missing, progress)


def _scan_batches(
    out: Path | str,
    samples: Collection[int] | None,
    batches: Collection[int] | None,
    lidars: Collection[str] | None,
    ply: bool,
    allow_missing: bool,
    progress: Callable[[int, int, str], None] | None,
) -> ScanReport:
    report = ScanReport()
    names: set[str] = set()
    found: list[Stray] = []
    for batch in find_batches(Path(out), batches):
        check_writable(batch.folder)
        sweep((batch.folder / SCANS).glob("*"))
        start = time.perf_counter()
        scene = read_stage(batch.stage, allow_missing=allow_missing)
        report.seconds["read"] += time.perf_counter() - start
        names |= {lidar.name for some in scene.lidars for lidar in some}
        report.warnings += [line for line in scene.losses if line not in report.warnings]
        beyond = [sample for sample in samples or () if sample >= scene.samples]
        if beyond:
            raise StageError(
                f"{batch.stage}: has samples 0 to {scene.samples - 1}, not {beyond[0]}"
            )
        wanted = [
            (sample, lidar)
            for sample, some in enumerate(scene.lidars)
            if samples is None or sample in samples
            for lidar in some
            if lidars is None or lidar.name in lidars
        ]
        _scan_batch(scene, batch.folder, wanted, ply, report, progress)
        if Path(out).is_dir() and not found:
            # Beside a USD file there may be the scans of another.
            firing = [[(lidar.name, True) for lidar in some] for some in scene.lidars]
            found = list(stray_scans(batch.folder, firing))
            report.warnings += [told(found)] if found else []
    unknown = [name for name in lidars or () if name not in names]
    if unknown or not names:
        what = f"no lidar {unknown[0]!r}{nearest(unknown[0], names)}" if unknown else "no lidar"
        raise StageError(f"{out}: has {what}")
    return report


def _scan_batch(
    scene: RenderScene,
    folder: Path,
    wanted: list[tuple[int, Lidar]],
    ply: bool,
    report: ScanReport,
    progress: Callable[[int, int, str], None] | None,
) -> None:
    key = scan_key(scene.digest, version_of())
    seconds, caster = report.seconds, None
    for done, (sample, lidar) in enumerate(wanted, 1):
        stem = scan_stem(folder, lidar.name, sample)
        # The name is the stage's, and what lies there may be a link.
        inside(folder, stem.relative_to(folder).as_posix(), "the stage")
        report.scans.append(stem)
        if not is_scanned(stem, key, ply):
            start = time.perf_counter()
            caster = caster or ExactCaster(scene)
            loaded = time.perf_counter()
            arrays = scan(scene, caster, lidar, sample)
            scanned = time.perf_counter()
            write_scan(stem, arrays, plain(_sidecar(scene, lidar, sample, key)), ply)
            seconds["load"] += loaded - start
            seconds["scan"] += scanned - loaded
            seconds["write"] += time.perf_counter() - scanned
            report.made += 1
        if progress is not None:
            progress(done, len(wanted), f"{folder.name}/{lidar.name}/{sample:06d}")


def _sidecar(scene: RenderScene, lidar: Lidar, sample: int, key: str) -> dict[str, object]:
    return {
        "lidar": lidar.name,
        "lidar_prim": lidar.path,
        "sample": sample,
        "time_s": float(scene.times[sample]) if sample < len(scene.times) else None,
        "lidar_to_world": lidar.to_world,
        "range_m": lidar.range_m,
        "noise": {
            "range_m": lidar.range_noise_m,
            "range_ratio": lidar.range_noise_ratio,
            "angle_deg": lidar.angle_noise_deg,
            "dropout": lidar.dropout,
            "key": lidar.key,
        },
        "labels": {
            level: {str(i): name for i, name in sorted(scene.label_names.get(level, {}).items())}
            for level in scene.levels
        },
        "instances": scene.instance_paths,
        "losses": scene.losses,
        "stage_digest": scene.digest,
        "resume_key": key,
    }
