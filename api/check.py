"""Is an output sound, do backends agree on it; is a dataset as it was written."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from scenec.api.check_text import agreement_lines, comparison_lines
from scenec.api.declare import Spread
from scenec.api.listener import Listener
from scenec.api.options import CheckOptions
from scenec.backends.check.compare import (
    PICTURES,
    Agreement,
    CompareOptions,
    check_exact,
    compare,
)
from scenec.backends.check.files import check_files
from scenec.backends.check.finding import Finding
from scenec.backends.check.frames import check_frames, check_scans, sensors_with_frames
from scenec.backends.check.scene import check_scene
from scenec.backends.check.stage import NOT_WHOLE, check_stage
from scenec.backends.registry import require_name
from scenec.backends.stage.read import read_stage
from scenec.schemas.codec import Facts
from scenec.schemas.errors import OutputError, ScenecError, StageError
from scenec.schemas.manifest import MANIFEST, find_batches, read_manifest
from scenec.schemas.passes import ANNOTATION_NAMES
from scenec.schemas.sweep import is_sweep, read_sweep

if TYPE_CHECKING:
    from scenec.datasets.verify import Comparison, Flaw

#: Checks that a stage is whole.
_WHOLE = ("files", "assets", *(f"UsdValidation:{name}" for name in NOT_WHOLE))
#: What makes a folder a dataset, see ``scenec.datasets.export``.
EXPORT = "export.json"


@dataclass(frozen=True)
class CheckReport:
    """Reports faults of an output folder or a dataset.

    Attributes:
        findings: On files, stages and frames of an output.
        flaws: Of a dataset.
        agreement: Of the backends that were asked for; None: of none, or there are errors.
        exact: Of the frames there are with the exact ray caster, where that was asked for.
        compared: With another dataset or output, where that was asked for.
        is_dataset: Whether a dataset was checked, or annotation compared: there are no findings.
    """

    findings: tuple[Finding, ...] = ()
    flaws: tuple[Flaw, ...] = ()
    agreement: Agreement | None = None
    exact: Agreement | None = None
    compared: Comparison | None = None
    is_dataset: bool = False

    @property
    def errors(self) -> int:
        """Number of errors; findings may be warnings, too."""
        return len(self.flaws) + sum(f.severity == "error" for f in self.findings)

    @property
    def sound(self) -> bool:
        """Whether nothing is wrong, and what was compared is the same."""
        differing = any(found.differing for found in (self.agreement, self.exact) if found)
        other = self.compared is not None and not self.compared.same
        return not (self.errors or differing or other)

    def as_json(self) -> Facts:
        """For scripts."""
        if self.is_dataset:
            other = self.compared
            compared = None if other is None else {"same": other.same, **asdict(other)}
            return {"flaws": [asdict(flaw) for flaw in self.flaws], "against": compared}
        return {
            "findings": [asdict(f) for f in self.findings],
            "agreement": None if self.agreement is None else agreement_json(self.agreement),
            "exact": None if self.exact is None else agreement_json(self.exact),
        }

    def __str__(self) -> str:
        lines = [str(one) for one in (*self.findings, *self.flaws)]
        warnings = len(self.findings) + len(self.flaws) - self.errors
        lines.append(f"{self.errors} errors, {warnings} warnings")
        for agreement in (self.agreement, self.exact):
            lines += () if agreement is None else agreement_lines(agreement)
        lines += () if self.compared is None else comparison_lines(self.compared)
        return "\n".join(lines)


@Spread(CheckOptions).one
def check(out: Path | str, options: CheckOptions) -> CheckReport:
    """Checks an output folder, all points of a sweep, a USD file, or a dataset of ``export``.

    Args:
        out: What is checked.
        options: As fields of ``CheckOptions``.

    Raises:
        ScenecError: What is asked for makes no sense, or cannot be read at all.
    """
    out = Path(out)
    if options.against is not None or (out / EXPORT).is_file():
        return _check_dataset(out, options)
    if is_sweep(out):
        return _check_sweep(out, options)
    for name in options.backends:
        require_name(name)
    if options.backends and set(options.backends) <= set(ANNOTATION_NAMES):
        raise ScenecError(
            f"--backends {','.join(options.backends)}: names no renderer; renderers are held "
            "against the annotation"
        )
    say = options.listener.say
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
    return CheckReport(tuple(findings), agreement=agreement, exact=exact)


def _check_sweep(out: Path, options: CheckOptions) -> CheckReport:
    """Checks each point of a sweep; what is found is named by the point's folder."""
    if options.backends or options.exact:
        raise ScenecError(f"{out}: is a sweep; give --backends and --exact one of its points")
    listed = read_sweep(out)
    findings: list[Finding] = []
    for point in listed.points:
        folder = out / point.folder
        if (folder / MANIFEST).is_file():
            found = find(folder, options.allow_missing)
            findings += [replace(one, where=f"{point.folder}: {one.where}") for one in found]
        else:
            findings.append(Finding("sweep", "error", point.folder, f"is not there: {point.state}"))
    return CheckReport(tuple(findings))


def _check_dataset(out: Path, options: CheckOptions) -> CheckReport:
    if options.backends or options.exact:
        raise ScenecError(
            f"{out}: --backends and --exact are about the frames of an output folder, not "
            "about datasets or --against"
        )
    # Imported here: what checks stages needs nothing of datasets.
    from scenec.datasets.models.verify import is_models, verify_models
    from scenec.datasets.verify import compare, is_dataset, verify

    flaws: list[Flaw] = []
    if is_models(out):
        if options.against is not None:
            raise OutputError(f"--against: {out} holds models of stages, and no annotation")
        flaws = verify_models(out)
    elif is_dataset(out):
        flaws = verify(out) or _opened(out, options.listener)
    compared = None
    if options.against is not None:
        compared = compare(out, Path(options.against), options.listener.say)
    return CheckReport(flaws=tuple(flaws), compared=compared, is_dataset=True)


def _opened(folder: Path, listener: Listener) -> list[Flaw]:
    """Lists the flaws that the format's own reader finds, where it is installed."""
    from scenec.datasets.verify import opened

    try:
        return opened(folder)
    except OutputError as error:
        listener.say(f"not opened by its own reader: {error}")
        return []


def _how(out: Path, options: CheckOptions) -> CompareOptions:
    return CompareOptions(
        spp=options.spp,
        passes=None if options.passes is None else tuple(options.passes),
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
    found = sensors_with_frames(batches) if out.is_dir() else None
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


def agreement_json(agreement: Agreement) -> Facts:
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
                "relative_mse": _numbers_only(r.relative_mse),
                "noise_relative_mse": _numbers_only(r.noise),
                "flip": _numbers_only(r.flip),
                "flip_floor": _numbers_only(r.floor),
            }
            for r in agreement.radiance
        ],
        "pictures": [str(path) for path in agreement.pictures],
    }


def _numbers_only(values: list[float]) -> list[float | None]:
    return [None if math.isnan(value) else value for value in values]
