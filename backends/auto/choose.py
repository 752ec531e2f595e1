"""Which backend renders, from curves that are there or that are measured on the spot."""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from scenec.backends.auto import curves as curves_
from scenec.backends.auto.calibrate import RUNGS, SECONDS, calibrate
from scenec.backends.auto.curves import Curve
from scenec.backends.auto.predict import Ask, Prediction, decide
from scenec.backends.converge.report import JSON
from scenec.backends.converge.run import FOLDER
from scenec.backends.jobs import Jobs, Wanted
from scenec.backends.pool import WorkerProcess
from scenec.backends.registry import ANNOTATION_ONLY, backend_names
from scenec.backends.watch import Limits
from scenec.schemas.errors import BackendError, OutputError, StageError
from scenec.schemas.files import write_json
from scenec.schemas.manifest import Batch, read_manifest, stage_digest

Say = Callable[[str], None]

#: In ``OUT/converge``.
CALIBRATION = "calibration.json"
#: Reads the stage and has nothing to start.
_READER = "reference"


@dataclass(frozen=True)
class Choice:
    """A backend, and why it.

    Attributes:
        backend: Name.
        reason: In words.
        asked: What for, in words.
        source: File of the curves, relative to the output folder.
        candidates: What was expected of each.
        left_out: Backends that could not be candidates, and why.
    """

    backend: str
    reason: str
    asked: str
    source: str
    candidates: tuple[Prediction, ...]
    left_out: dict[str, str]

    def as_json(self) -> dict[str, Any]:
        """As sidecars and ``--json`` hold it."""
        return {**asdict(self), "candidates": [asdict(one) for one in self.candidates]}

    def lines(self) -> list[str]:
        """For people."""
        found = [f"auto: {self.asked}, by the curves in {self.source}"]
        found += [f"auto: {one.backend}: {one.text}" for one in self.candidates]
        found += [f"auto: {name} is left out: {why}" for name, why in self.left_out.items()]
        return [*found, f"auto: {self.backend} renders: {self.reason}"]


def choose(
    out: Path, batches: Sequence[Batch], wanted: Wanted, limits: Limits | None = None,
    say: Say = lambda _line: None,
) -> Choice:  # fmt: skip
    """Choose the backend that is to render, and say why.

    Curves are those of ``OUT/converge/converge.json`` if they were measured on stages that are
    still there; otherwise those of ``OUT/converge/calibration.json``, which is made if it is not
    there or is of other stages, backends or versions. The same curves and the same wish end in the
    same choice. Annotation alone goes by a calibration, since ``reference`` has no other curve.

    Args:
        out: Output folder, or a USD file.
        batches: To render.
        wanted: What is to be rendered; its ``backend`` does not count.
        limits: What a worker may take.
        say: Told the candidates, the reasons, and what is done meanwhile.

    Raises:
        StageError: The stage cannot be read, or does not hold what is asked for.
        BackendError: No backend works here, or none comes near what is asked for.
        OutputError: The calibration cannot be written.
    """
    choice = _Choosing(out, batches, wanted, limits or Limits(), say).choice()
    for line in choice.lines():
        say(line)
    return choice


class _Choosing:
    """One call of ``choose``."""

    def __init__(
        self, out: Path, batches: Sequence[Batch], wanted: Wanted, limits: Limits, say: Say
    ) -> None:
        self._out = out
        self._folder = (out if out.is_dir() else out.parent) / FOLDER
        self._batch = batches[0]
        self._wanted = wanted
        self._limits = limits
        self._say = say
        with WorkerProcess(limits=limits) as worker:
            reading = Wanted(
                _READER,
                passes=wanted.passes,
                samples=wanted.samples,
                denoise=wanted.denoise,
                cameras=wanted.cameras,
            )
            jobs = Jobs(self._batch, reading)
            self._digest: str = jobs.open(worker, None)["digest"]
            if not jobs.count:
                raise StageError(
                    f"{self._batch.stage}: no frame to render: no camera is triggered in the range "
                    "asked for"
                )
            self.ask = Ask(
                frames=jobs.count * len(batches),
                pixels=jobs.pixels,
                rgb=jobs.rgb,
                annotated=jobs.annotated,
                spp=wanted.spp,
                error=wanted.error,
                seconds=wanted.seconds,
            )

    def choice(self) -> Choice:
        """What to render with."""
        names = [name for name in backend_names() if not (self.ask.rgb and name in ANNOTATION_ONLY)]
        works, left_out = self._try(names)
        source, found = self._of_file(JSON, curves_.of_report, lambda report: report)
        curves: list[Curve] = []
        if self.ask.rgb and found is not None:
            curves, why = _current(found, works)
            unseen = {name: "it has no curve there" for name in works} | why
            more = {name: unseen[name] for name in works if name not in {c.backend for c in curves}}
            if curves:
                left_out |= more
        if not curves:
            source = f"{FOLDER}/{CALIBRATION}"
            curves = self._calibrated(works, left_out)
        best, candidates, reason = decide(curves, self.ask)
        return Choice(
            best.backend, reason, self.ask.text, source, tuple(candidates),
            dict(sorted(left_out.items())),
        )  # fmt: skip

    def _try(self, names: Sequence[str]) -> tuple[dict[str, dict[str, Any]], dict[str, str]]:
        """Start each backend; what it says of itself, or why it is left out."""
        works: dict[str, dict[str, Any]] = {}
        left_out: dict[str, str] = {}
        for name in names:
            request = {
                "op": "describe", "backend": name, "device": self._wanted.device, "rgb": False
            }  # fmt: skip
            try:
                with WorkerProcess(limits=self._limits) as worker:
                    works[name] = worker.ask(request, f"backend {name}")
                if self._wanted.denoise and works[name]["denoiser"] is None:
                    raise BackendError(f"backend {name} has no denoiser")
            except BackendError as error:
                works.pop(name, None)
                left_out[name] = str(error)
        if not works:
            reasons = "; ".join(left_out.values())
            raise BackendError(f"no backend works here for what is asked: {reasons}")
        return works, left_out

    def _of_file(
        self, name: str, parse: Callable[[Any], list[Curve]], part: Callable[[dict[str, Any]], Any]
    ) -> tuple[str, list[Curve] | None]:
        """Curves of a file that was made from stages that are there; None if it was not."""
        report = curves_.read(self._folder / name)
        source = f"{FOLDER}/{name}"
        if report is None:
            return source, None
        try:
            stages = set(report["stages"].values())
            found = parse(part(report))
        except (KeyError, TypeError, ValueError, AttributeError, StopIteration):
            return source, None
        if not stages or not stages <= self._digests():
            return source, None
        return source, found

    def _digests(self) -> set[str]:
        """Of all stages of the output."""
        found = {self._digest}
        if self._out.is_dir():
            manifest = read_manifest(self._out)
            found |= {stage_digest(manifest, str(b["path"])) for b in manifest["batches"]}
        return found

    def _calibrated(
        self, works: dict[str, dict[str, Any]], left_out: dict[str, str]
    ) -> list[Curve]:
        """Curves of a calibration that is there, or of one that is made now."""
        kind = {"rgb": self.ask.rgb, "annotated": self.ask.annotated}
        path = self._folder / CALIBRATION
        report = curves_.read(path) or {}
        _, found = self._of_file(CALIBRATION, curves_.of_json, lambda report: report["curves"])
        if found is not None and report.get("asked") == kind:
            found, _ = _current(found, works)
            failed = report.get("failed")
            known = {curve.backend for curve in found}
            if isinstance(failed, dict) and known and set(works) <= known | set(failed):
                left_out |= {name: why for name, why in failed.items() if name in works}
                return found
        self._say(
            f"auto: calibrating {', '.join(works)} on the first frame: each starts once"
            + (f" and draws {_listed(RUNGS)} samples per pixel, beginning none after "
               f"{SECONDS:g} s" if self.ask.rgb else "")
        )  # fmt: skip
        start = time.perf_counter()
        found, failed = calibrate(
            self._batch, list(works), self._wanted, self.ask.rgb, self._limits, self._say
        )
        left_out |= failed
        seconds = time.perf_counter() - start
        self._say(f"auto: calibrated in {seconds:.1f} s")
        if not found:
            raise BackendError(f"no backend works here: {'; '.join(failed.values())}")
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise OutputError(f"{self._folder}: cannot make: {error.strerror}") from error
        write_json(
            path,
            {
                "stages": {self._batch.name: self._digest},
                "asked": kind,
                "seconds": seconds,
                "curves": curves_.as_json(found),
                "failed": failed,
            },
        )
        return found


def _current(
    found: Sequence[Curve], works: dict[str, dict[str, Any]]
) -> tuple[list[Curve], dict[str, str]]:
    """Curves of backends as they are here; of the others, what is not."""
    same, other = [], {}
    for curve in found:
        about = works.get(curve.backend)
        if about is None:
            continue
        if (about["version"], about["device"]) == (curve.version, curve.device):
            same.append(curve)
        else:
            other[curve.backend] = f"its curve is of {curve.version} on {curve.device}"
    return same, other


def _listed(numbers: Collection[int]) -> str:
    return ", ".join(map(str, numbers))
