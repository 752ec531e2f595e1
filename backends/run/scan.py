"""All lidar scans of an output: no renderer is needed."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Collection, Iterable
from contextlib import ExitStack, closing
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from scenec.backends.annotation.lidar import scan
from scenec.backends.run.executors import make_executor
from scenec.backends.run.facts import label_names, rows, time_of
from scenec.backends.run.frames import require_samples
from scenec.backends.run.units import OfSession, Opening
from scenec.backends.stage.scene import Lidar, RenderScene
from scenec.schemas.errors import StageError
from scenec.schemas.files import check_writable, inside, sweep
from scenec.schemas.frames import ANNOTATION
from scenec.schemas.manifest import Batch, find_batches
from scenec.schemas.records import NOT_WRITTEN, LidarNoise, ScanRecord
from scenec.schemas.scans import SCANS, is_scanned, scan_key, scan_stem, write_scan
from scenec.schemas.spelling import nearest
from scenec.schemas.strays import stray_scans, told
from scenec.schemas.units import Executor, run_all
from scenec.schemas.update import reading
from scenec.schemas.versions import version_of

if TYPE_CHECKING:
    from scenec.backends.run.session import Session


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

    def warn(self, lines: Iterable[str]) -> None:
        """Notes lines, each once."""
        self.warnings += [line for line in lines if line not in self.warnings]


@dataclass(frozen=True)
class Found:
    """What a stage holds for lidars.

    Attributes:
        digest: Of the stage.
        lidars: Names, of each sample.
        losses: A line for each thing that is not read.
    """

    digest: str
    lidars: list[list[str]]
    losses: tuple[str, ...]


def scan_output(
    out: Path | str,
    *,
    samples: Collection[int] | None = None,
    batches: Collection[int] | None = None,
    lidars: Collection[str] | None = None,
    ply: bool = False,
    allow_missing: bool = False,
    progress: Callable[[int, int, str], None] | None = None,
    executor: Executor | None = None,
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
        executor: Who scans, see ``run.executors``; None: one process of its own.

    Raises:
        StageError: A stage cannot be read or is not whole, or no stage has what is asked for.
        OutputError: A file cannot be written.
        BackendError: Workers died over it, again and again.
    """
    out, report = Path(out), ScanReport()
    names: set[str] = set()
    strayed = False
    with ExitStack() as stack:
        stack.enter_context(reading(out))
        found = find_batches(out, batches)
        executor = executor or stack.enter_context(make_executor())
        executor.prepare(found[0].folder)
        for batch in found:
            check_writable(batch.folder)
            sweep((batch.folder / SCANS).glob("*"))
            opening = Opening(os.path.abspath(batch.stage), ANNOTATION, allow_missing=allow_missing)
            reads = OfSession(opening, f"opening {opening.stage}", _find)
            start = time.perf_counter()
            ((_, outcome),) = run_all(executor, [reads])
            there: Found = outcome.result()
            report.seconds["read"] += time.perf_counter() - start
            names |= {name for some in there.lidars for name in some}
            report.warn(there.losses)
            require_samples(batch, samples, len(there.lidars))
            wanted = [
                (sample, number, name)
                for sample, some in enumerate(there.lidars)
                if samples is None or sample in samples
                for number, name in enumerate(some)
                if lidars is None or name in lidars
            ]
            _scan_batch(batch, opening, there, wanted, report, executor, ply, progress)
            if out.is_dir() and not strayed:
                # Beside a USD file there may be the scans of another.
                firing = [[(name, True) for name in some] for some in there.lidars]
                strays = list(stray_scans(batch.folder, firing))
                strayed = bool(strays)
                report.warn([told(strays)] if strays else [])
    unknown = [name for name in lidars or () if name not in names]
    if unknown or not names:
        what = f"no lidar {unknown[0]!r}{nearest(unknown[0], names)}" if unknown else "no lidar"
        raise StageError(f"{out}: has {what}")
    return report


def _scan_batch(
    batch: Batch,
    opening: Opening,
    there: Found,
    wanted: list[tuple[int, int, str]],
    report: ScanReport,
    executor: Executor,
    ply: bool,
    progress: Callable[[int, int, str], None] | None,
) -> None:
    key = scan_key(there.digest, version_of())
    units, done = [], 0

    def tell(what: str) -> None:
        nonlocal done
        done += 1
        if progress is not None:
            progress(done, len(wanted), what)

    for sample, number, name in wanted:
        stem = scan_stem(batch.folder, name, sample)
        # The name is the stage's, and what lies there may be a link.
        inside(batch.folder, stem.relative_to(batch.folder).as_posix(), "the stage")
        report.scans.append(stem)
        what = f"{batch.folder.name}/{name}/{sample:06d}"
        if is_scanned(stem, key, ply):
            tell(what)
        else:
            scans = partial(_scan, stem.absolute(), (sample, number), key, ply)
            units.append(OfSession(opening, what, scans))
    with closing(run_all(executor, units)) as ended:
        for unit, outcome in ended:
            report.warn(outcome.warnings)
            for step, seconds in outcome.result().items():
                report.seconds[step] += seconds
            report.made += 1
            tell(unit.what)


def _find(session: Session) -> Found:
    scene = session.scene
    names = [[lidar.name for lidar in some] for some in scene.lidars]
    return Found(scene.digest, names, scene.losses)


def _scan(
    stem: Path, place: tuple[int, int], key: str, ply: bool, session: Session
) -> dict[str, float]:
    """Make a scan; returns seconds per step."""
    sample, number = place
    scene, lidar = session.scene, session.scene.lidars[sample][number]
    start = time.perf_counter()
    caster = session.caster()
    loaded = time.perf_counter()
    arrays = scan(scene, caster, lidar, sample)
    scanned = time.perf_counter()
    write_scan(stem, arrays, _sidecar(scene, lidar, sample, key), ply)
    written = time.perf_counter()
    return {"load": loaded - start, "scan": scanned - loaded, "write": written - scanned}


def _sidecar(scene: RenderScene, lidar: Lidar, sample: int, key: str) -> ScanRecord:
    return ScanRecord(
        lidar=lidar.name,
        lidar_prim=lidar.path,
        sample=sample,
        time_s=time_of(scene, sample),
        lidar_to_world=rows(lidar.to_world),
        range_m=lidar.range_m,
        noise=LidarNoise(
            range_m=lidar.range_noise_m,
            range_ratio=lidar.range_noise_ratio,
            angle_deg=lidar.angle_noise_deg,
            dropout=lidar.dropout,
            key=lidar.key,
        ),
        labels=label_names(scene),
        instances=scene.instance_paths,
        losses=tuple(scene.losses),
        stage_digest=scene.digest,
        resume_key=key,
        npz=NOT_WRITTEN,
    )
