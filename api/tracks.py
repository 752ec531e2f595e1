"""Point tracks of stages and their frames: points are chosen, then followed, frame by frame."""

from __future__ import annotations

import hashlib
from collections.abc import Collection, Sequence
from dataclasses import fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.api.models import ModelsReport, chosen_batches
from scenec.api.options import ExportOptions
from scenec.api.stage_export import StageExport, opening, parsed
from scenec.backends.run.point_tracks import ChoosePoints, DescribeCameras, FollowPoints
from scenec.datasets.pictures import has_picture, picture
from scenec.datasets.source import FrameRef, Source
from scenec.datasets.tracks import SETTINGS, TAPVID
from scenec.datasets.tracks.files import write_arrays, write_pickle, write_table
from scenec.datasets.tracks.sheet import write_track_sheet
from scenec.schemas.codec import JsonObject
from scenec.schemas.correspondence import VISIBLE
from scenec.schemas.errors import FrameError, OutputError
from scenec.schemas.manifest import Batch
from scenec.schemas.point_tracks import (
    CameraFrames,
    TrackFacts,
    TrackOptions,
    TrackPoints,
    TrackSights,
)
from scenec.schemas.spelling import nearest

#: Options that choose frames make sense here.
_TAKES = ("backend", "cameras", "samples", "cluster")


def export_tracks(out: Path, options: ExportOptions) -> ModelsReport:
    """Writes a folder a batch with point tracks of each camera, and ``export.json`` about them.

    Args:
        out: Output folder of a compile and a render, or a USD file.
        options: Those that filter instances or labels must not be set.

    Raises:
        StageError: A stage cannot be read, or has not what is asked for.
        FrameError: A frame is missing, foreign or damaged.
        OutputError: An option makes no sense, or the folder holds another dataset.
    """
    asked = track_options(options.settings)
    batches = chosen_batches(out, TAPVID, options, _TAKES)
    return _Tracks.export(out, batches, asked, options)


def track_options(settings: Sequence[str]) -> TrackOptions:
    """The tracks that ``--set`` asks for.

    Raises:
        OutputError: A name is unknown, or a value makes no sense.
    """
    given: dict[str, Any] = {}
    numbers = {f.name for f in fields(TrackOptions) if f.type == "int"}
    for name, (value, text) in parsed(settings, list(SETTINGS)).items():
        given[name] = value
        if name in numbers:
            if not value.isdecimal():
                raise OutputError(f"--set {text!r}: expected a whole number")
            given[name] = int(value)
    return TrackOptions(**given)


class _Tracks(StageExport[TrackFacts]):
    """One call of ``export_tracks``."""

    format, files, version = TAPVID, "point tracks", 1
    asked: TrackOptions

    def describe(self, batch: Batch) -> DescribeCameras:
        return DescribeCameras(opening(batch), self.asked)

    def identity(self, batch: Batch) -> str:
        digest = hashlib.sha256(super().identity(batch).encode())
        for camera in self._cameras(batch):
            digest.update(repr((camera.name, camera.samples)).encode())
            for ref in self._frames(batch, camera):
                digest.update(self._loaded(ref).picture_digest.encode())
        return digest.hexdigest()

    def make(self, batch: Batch, folder: Path, tiles: Path) -> tuple[JsonObject, list[str]]:
        facts = self.facts[batch.name]
        told, names = {}, []
        for camera in self._cameras(batch):
            points = self._choose(batch, facts, camera)
            sights = self._follow(batch, facts, camera, points)
            write_arrays(folder / f"{camera.name}.npz", camera, points, sights)
            table = folder / f"{camera.name}.csv"
            write_table(table, camera, points, sights, facts.label_names)
            names += [f"{camera.name}.npz", table.name]
            if self.source is not None:
                video = self._video(batch, camera)
                name = f"{batch.name}_{camera.name}"
                write_pickle(folder / f"{camera.name}.pkl", name, camera, sights, video)
                write_track_sheet(folder / f"{camera.name}.png", video, sights)
                names += [f"{camera.name}.pkl", f"{camera.name}.png"]
            told[camera.name] = self._told(camera, sights)
        labels = {
            level: {str(number): name for number, name in sorted(known.items())}
            for level, known in facts.label_names.items()
        }
        said = {
            "stage_digest": facts.digest,
            "cameras": told,
            "labels": labels,
            "instances": facts.instance_paths,
            "losses": list(facts.losses),
        }
        return said, names

    def _told(self, camera: CameraFrames, sights: TrackSights) -> dict[str, int]:
        """What ``export.json`` says of a camera's tracks."""
        tracks, asked = len(sights.code), self.asked.points
        if tracks < asked:
            self.options.listener.warn(
                f"{camera.name}: {tracks:,} points of {asked:,}; its pictures show no more surface"
            )
        return {
            "tracks": tracks,
            "frames": len(camera.samples),
            "visible": int((sights.code == VISIBLE).sum()),
            "undecided": int(sights.undecided.sum()),
        }

    def _cameras(self, batch: Batch) -> list[CameraFrames]:
        """The cameras that are asked for, with the samples that are.

        Raises:
            OutputError: One is not there, or has no frame.
        """
        facts = self.facts[batch.name]
        known = [camera.name for camera in facts.cameras]
        chosen, samples = self.options.cameras, self.options.samples
        for name in (*(chosen or ()), *([self.asked.camera] if self.asked.camera else ())):
            if name not in known:
                raise OutputError(f"{batch.stage}: no camera {name!r}{nearest(name, known)}")
        there = [taken for camera in facts.cameras if (taken := _at(camera, samples)).samples]
        found = [camera for camera in there if not chosen or camera.name in chosen]
        if not found or self.asked.camera not in ("", *(camera.name for camera in there)):
            what = f"camera {self.asked.camera}" if found else "a camera"
            raise OutputError(f"{batch.stage}: {what} has no frame at the samples asked for")
        return found

    def _choose(self, batch: Batch, facts: TrackFacts, camera: CameraFrames) -> TrackPoints:
        """The points that are followed in a camera's pictures."""
        source = camera
        if self.asked.camera:
            source = next(c for c in facts.cameras if c.name == self.asked.camera)
            source = _at(source, self.options.samples)
        counts = self.asked.per_frame(len(source.samples))
        units = [
            ChoosePoints(opening(batch), facts.digest, source.name, sample, count, self.asked)
            for sample, count in zip(source.samples, counts, strict=True)
            if count
        ]
        return TrackPoints.joined([points for _, points in self.done(units, in_order=True)])

    def _follow(
        self, batch: Batch, facts: TrackFacts, camera: CameraFrames, points: TrackPoints
    ) -> TrackSights:
        units = [
            FollowPoints(opening(batch), facts.digest, camera.name, sample, points)
            for sample in camera.samples
        ]
        steps = self.options.listener.steps("followed", unit="frame")
        found = []
        for number, (unit, sights) in enumerate(self.done(units, in_order=True), 1):
            found.append(sights)
            steps(number, len(units), unit.what)
        return TrackSights.joined(found)

    @cached_property
    def source(self) -> Source | None:
        """The frames whose pictures are the videos; None where none are asked for.

        Raises:
            FrameError: There are none.
        """
        if self.asked.video == "no":
            return None
        options = self.options
        try:
            return Source(
                self.out,
                options.backend,
                batches=options.batches,
                cameras=options.cameras,
                samples=options.samples,
            )
        except FrameError as error:
            raise FrameError(f"{error}; or --set video=no, for tracks without pictures") from None

    def _frames(self, batch: Batch, camera: CameraFrames) -> list[FrameRef]:
        """The frames of a video, one a sample.

        Raises:
            FrameError: One is missing.
        """
        if self.source is None:
            return []
        there = {
            ref.sample: ref
            for ref in self.source.frames
            if ref.batch == batch.index and ref.camera == camera.name
        }
        for sample in camera.samples:
            if sample not in there:
                raise FrameError(
                    f"{self.out}: {self.source.backend} has no frame {batch.name}/{camera.name}/"
                    f"{sample:06d}; render it, or --set video=no for tracks without pictures"
                )
        return [there[sample] for sample in camera.samples]

    def _loaded(self, ref: FrameRef) -> Any:
        """A frame, of which nothing but the picture is decoded.

        Raises:
            FrameError: It is damaged, foreign, or has no picture.
        """
        assert self.source is not None
        unused = tuple(name for name in self.source.passes() if name != "rgb")
        loaded = self.source.load(ref, unused=unused)
        if not has_picture(loaded):
            raise FrameError(
                f"{ref.stem}.exr: has no rgb; render with --passes …,rgb, or --set video=no"
            )
        return loaded

    def _video(self, batch: Batch, camera: CameraFrames) -> NDArray[np.uint8]:
        """The pictures, uint8 [frames, h, w, 3]."""
        width, height = camera.size
        video = np.empty((len(camera.samples), height, width, 3), np.uint8)
        for place, ref in enumerate(self._frames(batch, camera)):
            video[place] = picture(self._loaded(ref))
        return video


def _at(camera: CameraFrames, samples: Collection[int] | None) -> CameraFrames:
    """A camera with those of its samples that are asked for."""
    some = [s in samples if samples is not None else True for s in camera.samples]
    return replace(
        camera,
        samples=tuple(s for s, take in zip(camera.samples, some, strict=True) if take),
        times_s=tuple(t for t, take in zip(camera.times_s, some, strict=True) if take),
    )
