"""All lidar scans of an output: no renderer is needed."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Collection, Iterable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

from scenec.backends.annotation.lidar import scan
from scenec.backends.run.batches import BatchRun, WorkReport
from scenec.backends.run.executors import make_executor
from scenec.backends.run.facts import label_names, rows, time_of
from scenec.backends.run.frames import require_samples
from scenec.backends.run.units import MakeFile, Opened, Opening, UnitResult
from scenec.backends.stage.scene import Lidar, RenderScene
from scenec.schemas.errors import StageError
from scenec.schemas.files import check_writable, inside, sweep
from scenec.schemas.manifest import Batch, find_batches
from scenec.schemas.passes import ANNOTATION
from scenec.schemas.records import NOT_WRITTEN, LidarNoise, ScanRecord
from scenec.schemas.scans import SCANS, is_scanned, scan_key, scan_stem, write_scan
from scenec.schemas.spelling import nearest
from scenec.schemas.strays import stray_scans
from scenec.schemas.units import Executor, Keeper, Progress, Unit
from scenec.schemas.update import reading
from scenec.schemas.versions import version_of


@dataclass
class ScanReport(WorkReport):
    """Reports the outcome of a scan; steps are ``read``, ``load``, ``scan``, ``write``."""

    @property
    def scans(self) -> list[Path]:
        """Paths of all scans asked for, without suffix."""
        return self.stems


@dataclass(frozen=True)
class ScanLidar(MakeFile):
    """Makes a scan.

    Attributes:
        digest: Of the stage.
        clouds: Clouds of points to write beside the arrays, of ``schemas.clouds.CLOUDS``.
    """

    digest: str
    clouds: tuple[str, ...]

    @property
    def key(self) -> str:
        """Returns the resume key of the scan."""
        return scan_key(self.digest, version_of())

    def is_done(self) -> bool:
        """Tells whether it is there, with its clouds that are asked for."""
        return is_scanned(self.stem, self.key, self.clouds)

    def run(self, keeper: Keeper) -> UnitResult:
        """Casts its rays and writes it.

        Raises:
            StageError: The stage is no more what it was.
            OutputError: A file cannot be written.
        """
        session = self.holds.session(keeper)
        scene = session.scene
        if scene.digest != self.digest:
            raise StageError(f"{scene.source}: has changed since scanning began; run again")
        seconds: dict[str, float] = {}
        with self.claimed(session) as found:
            if found is not None:
                return found
            lidar, caster = scene.lidars[self.sample][self.number], session.caster(seconds)
            start = time.perf_counter()
            arrays = scan(scene, caster, lidar, self.sample)
            scanned = time.perf_counter()
            sidecar = _sidecar(scene, lidar, self.sample, self.key)
            write_scan(self.stem, arrays, sidecar, self.clouds)
            seconds |= {"scan": scanned - start, "write": time.perf_counter() - scanned}
        return UnitResult(now=True, seconds=seconds, text=f"{sum(seconds.values()):.2f} s")


def scan_output(
    out: Path | str,
    *,
    samples: Collection[int] | None = None,
    batches: Collection[int] | None = None,
    lidars: Collection[str] | None = None,
    clouds: Collection[str] = (),
    allow_missing: bool = False,
    progress: Progress | None = None,
    executor: Executor | None = None,
) -> ScanReport:
    """Scans to ``<batch>/scans/<rig>_<lidar>/<sample>.{npz,json}``; see ``schemas.scans``.

    Scans that are there and were made from the same stage are not made again. As of ``render``,
    several processes may scan one output at once, a batch whose stage cannot be read costs no
    other, and a scan that kills its worker again and again is given up.

    Args:
        out: Output folder of a compile, or a USD file.
        samples: Only these time codes.
        batches: Only these batches.
        lidars: Only these, by name (``<rig>_<lidar>``).
        clouds: Which clouds of points to write beside the arrays (``schemas.clouds.CLOUDS``).
        allow_missing: Whether to scan what is there of a stage that is not whole; sidecars then say
            what was missing, under ``losses``.
        progress: Called after each scan.
        executor: Who scans, see ``run.executors``; None: one process of its own.

    Raises:
        StageError: No stage can be read or is whole, or none has what is asked for.
        OutputError: A file cannot be written.
    """
    out = Path(out)
    report = ScanReport(seconds=dict.fromkeys(("read", "load", "scan", "write"), 0.0))
    with ExitStack() as stack:
        stack.enter_context(reading(out))
        found = find_batches(out, batches)
        executor = executor or stack.enter_context(make_executor())
        executor.prepare(found[0].folder)
        check_writable(*(batch.folder for batch in found))
        # No frame is made: what is wrong with a camera's passes costs no scan.
        openings = {
            Opening(os.path.abspath(of.stage), ANNOTATION, "auto", (), allow_missing): of
            for of in found
        }
        run = _Scan(openings, report, progress)
        run.samples, run.clouds, run.counts_strays = samples, tuple(clouds), out.is_dir()
        run.names = set()
        run.wanted = lambda sample, name: (
            (samples is None or sample in samples) and (lidars is None or name in lidars)
        )
        run.run(executor)
    unknown = [name for name in lidars or () if name not in run.names]
    if unknown or not run.names:
        what = f"no lidar {unknown[0]!r}{nearest(unknown[0], run.names)}" if unknown else "no lidar"
        raise StageError(f"{out}: has {what}")
    return report


class _Scan(BatchRun):
    """One call of ``scan_output``.

    Attributes:
        wanted: Whether a sample's scan by a lidar of this name is asked for.
        samples, clouds: As of ``scan_output``.
        counts_strays: Whether scans of an earlier stage are looked for.
        names: Of all lidars of the stages.
    """

    wanted: Callable[[int, str], bool]
    samples: Collection[int] | None
    clouds: tuple[str, ...]
    counts_strays: bool
    names: set[str]

    def files(self, batch: Batch, holds: Opening, opened: Opened) -> Sequence[ScanLidar]:
        """Lists the scans that are asked for.

        Raises:
            StageError: The stage does not hold a sample.
        """
        self.report.add_seconds({"read": opened.read_s})
        self.names |= {name for some in opened.lidars for name in some}
        self.warn(*opened.losses)
        require_samples(batch, self.samples, len(opened.lidars))
        found = []
        for sample, some in enumerate(opened.lidars):
            for number, name in enumerate(some):
                if not self.wanted(sample, name):
                    continue
                stem = scan_stem(batch.folder, name, sample)
                # The name is the stage's, and what lies there may be a link.
                inside(batch.folder, stem.relative_to(batch.folder).as_posix(), "the stage")
                what = f"{batch.folder.name}/{name}/{sample:06d}"
                place = stem.absolute(), name, number, sample
                found.append(ScanLidar(holds, what, *place, opened.digest, self.clouds))
        return found

    def begin(self, batch: Batch, opened: Opened, files: Sequence[MakeFile]) -> Iterable[Unit]:
        """Clears up, and tells of what nothing replaces."""
        sweep((batch.folder / SCANS).glob("*"))
        if self.counts_strays:
            # Beside a USD file there may be the scans of another.
            firing = [[(name, True) for name in some] for some in opened.lidars]
            self.warn_of_strays(stray_scans(batch.folder, firing))
        return []


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
        intensity=lidar.intensity,
        footprint=lidar.footprint,
        detection=lidar.detection,
        labels=label_names(scene),
        instances=scene.instance_paths,
        losses=tuple(scene.losses),
        stage_digest=scene.digest,
        resume_key=key,
        npz=NOT_WRITTEN,
    )
