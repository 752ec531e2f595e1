"""Rectifies frames as units of work: what a pinhole at the camera's place shows, camera by camera.

The picture is resampled (``KERNEL``); annotation is not: the exact caster annotates the pinhole
itself, so labels, ids and depth are blended nowhere and have no error. Pixels of the pinhole that
the camera's picture does not reach are black, annotated all the same, and counted in the sidecar.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from scenec.backends.annotation.registry import find_pass
from scenec.backends.run.units import Opening
from scenec.schemas.amodal import amodal_path, write_amodal
from scenec.schemas.codec import encode
from scenec.schemas.correspondence import PARTNER
from scenec.schemas.errors import FrameError, StageError
from scenec.schemas.exr import write_exr
from scenec.schemas.files import sha256, write_json
from scenec.schemas.frames import Frame, read_frame
from scenec.schemas.instances import frame_table_path, write_frame_table
from scenec.schemas.lens import directions, pixels_at, to_plane
from scenec.schemas.passes import AMODAL, ANNOTATION, origins
from scenec.schemas.picture import RENDERED, develop, write_png
from scenec.schemas.records import FileDigest, FrameRecord, Rectification, RectifiedRecord
from scenec.schemas.sidecars import lens_of, read_sidecar
from scenec.schemas.units import Keeper
from scenec.schemas.versions import version_of

if TYPE_CHECKING:
    from scenec.backends.annotation.instances import FrameInstances
    from scenec.backends.run.session import Session
    from scenec.backends.stage.scene import Camera

KERNEL = (
    "cubic convolution (Keys 1981, a = -1/2) of the 4 x 4 nearest pixels, held between the least "
    "and the greatest of the 2 x 2 nearest"
)


@dataclass(frozen=True)
class RectifiedOpening:
    """Opens a stage whose cameras are the pinholes that they are taken to.

    Attributes:
        stage: Absolute path.
        cameras: Name of each that becomes another, and how.
    """

    stage: str
    cameras: tuple[tuple[str, Rectification], ...]

    def session(self, keeper: Keeper) -> Session:
        """The stage, read, without a renderer."""
        return keeper.keep(self, self._open)

    def _open(self) -> Session:
        from scenec.backends.run.session import Session

        scene = Opening(self.stage, ANNOTATION).session(Keeper()).scene
        views = dict(self.cameras)
        cameras = tuple(
            tuple(_pinhole(one, views[one.name]) if one.name in views else one for one in of)
            for of in scene.cameras
        )
        return Session(replace(scene, cameras=cameras), None)


def _pinhole(camera: Camera, view: Rectification) -> Camera:
    pose = camera.camera_to_world.copy()
    # The axes of the pinhole in those of the camera are the columns of the turn back.
    pose[:3, :3] = (pose[:3, :3, None] * np.array(view.turn).T[None]).sum(axis=1)
    intrinsics = np.array(view.intrinsics)
    return replace(
        camera, camera_to_world=pose, intrinsics=intrinsics, lens=None, shutter=None, focus=None
    )


@dataclass(frozen=True)
class RectifyFrame:
    """Rectifies a frame, unless it is there; returns how many of its pixels have no picture.

    Attributes:
        holds: Its stage.
        what: Its name in messages.
        source, stem: The frame, and the rectified one: paths without a suffix, absolute.
    """

    holds: RectifiedOpening
    what: str
    source: Path
    stem: Path

    def run(self, keeper: Keeper) -> int:
        """Writes it; the sidecar last.

        Raises:
            FrameError: The frame is damaged.
            StageError: The stage is not the one that it shows.
            OutputError: A file cannot be written.
        """
        record = read_sidecar(self.source.with_suffix(".json"))
        view = dict(self.holds.cameras)[record.camera]
        key = _key(record, self.source, view)
        unseen = _done(self.stem, key)
        if unseen is not None:
            return unseen
        frame = read_frame(self.source)
        session = self.holds.session(keeper)
        if session.scene.digest != record.stage_digest:
            raise StageError(
                f"{self.source}.json: shows another stage than {session.scene.source}; --rectify "
                "needs the stage that was rendered"
            )
        cameras = session.scene.cameras[record.sample]
        camera = next(one for one in cameras if one.name == record.camera)
        self.stem.with_suffix(".json").unlink(missing_ok=True)
        self.stem.parent.mkdir(parents=True, exist_ok=True)
        pixels = _source_pixels(record, view)
        passes = [name for name in frame.passes if name != "rgb"]
        passes += [AMODAL] if record.amodal is not None else []
        if view.paired and camera.partner is not None:
            passes += [name for name in PARTNER if name not in passes]
        found = session.complete(camera, record.sample, passes, None, None, {})
        arrays = dict(found.arrays)
        if "rgb" in frame.passes:
            arrays = {"rgb": _resampled(frame.passes["rgb"], pixels), **arrays}
        return self._write(frame, arrays, found.record, found.seen, pixels, key, view)

    def _write(
        self,
        frame: Frame,
        arrays: dict[str, NDArray[Any]],
        made: FrameRecord,
        seen: FrameInstances | None,
        pixels: NDArray[np.float64],
        key: str,
        view: Rectification,
    ) -> int:
        record, stem = frame.sidecar, self.stem
        exr, table, amodal = stem.with_suffix(".exr"), None, None
        write_exr(exr, arrays, {name: find_pass(name) for name in origins(arrays)})
        if record.png:
            if record.imaging is not None or record.effects:
                # It is more than light developed.
                with Image.open(self.source.with_suffix(".png")) as image:
                    shown = _resampled(np.asarray(image.convert("RGB")), pixels)
            else:
                shown = develop(arrays["rgb"], record.exposure_ev)
            write_png(stem.with_suffix(".png"), shown, level=RENDERED)
        if seen is not None:
            write_frame_table(frame_table_path(stem), seen.table)
            table = _vouch(frame_table_path(stem))
            if seen.amodal is not None and record.amodal is not None:
                write_amodal(amodal_path(stem), seen.amodal)
                amodal = _vouch(amodal_path(stem))
        unseen = int(np.isnan(pixels[..., 0]).sum())
        imaging = record.imaging and replace(record.imaging, clean=None, raw=None)
        record = replace(
            record,
            intrinsics=made.intrinsics,
            lens=None,
            shutter=None,
            camera_to_world=made.camera_to_world,
            passes=tuple(arrays),
            resume_key=key,
            exr=_vouch(exr),
            picture=None,
            half=None,
            instance_table=table,
            amodal=amodal,
            imaging=imaging,
            height_above_surface_m=made.height_above_surface_m,
            sky=made.sky,
            annotation=made.annotation,
            rectified=RectifiedRecord(turn=view.turn, kernel=KERNEL, unseen_pixels=unseen),
        )
        write_json(stem.with_suffix(".json"), encode(record))
        return unseen


def _key(record: FrameRecord, source: Path, view: Rectification) -> str:
    """Digest of all that decides a rectified frame."""
    png = source.with_suffix(".png")
    picture = sha256(png) if record.png and png.is_file() else ""
    values = [version_of(), KERNEL, record.resume_key, record.exr.sha256, picture, encode(view)]
    return hashlib.sha256(json.dumps(values).encode()).hexdigest()


def _done(stem: Path, key: str) -> int | None:
    """Pixels without a picture of the frame that is there as it should be; None: there is none."""
    try:
        record = read_sidecar(stem.with_suffix(".json"))
        size = stem.with_suffix(".exr").stat().st_size
    except (OSError, FrameError):
        return None
    there = record.resume_key == key and size == record.exr.bytes and record.rectified is not None
    return record.rectified.unseen_pixels if there and record.rectified else None


def _vouch(path: Path) -> FileDigest:
    return FileDigest(bytes=path.stat().st_size, sha256=sha256(path))


def _source_pixels(record: FrameRecord, view: Rectification) -> NDArray[np.float64]:
    """Where the camera's picture shows what each pixel of the pinhole sees, float64 [h, w, 2].

    NaN where it does not.
    """
    width, height = record.resolution
    v, u = np.indices((height, width)).reshape(2, -1).astype(np.float64) + 0.5
    rays, _ = directions(None, *to_plane(np.array(view.intrinsics), u, v))
    turned = (rays[:, :, None] * np.array(view.turn)[None]).sum(axis=1)
    found = pixels_at(lens_of(record.lens), np.array(record.intrinsics), turned)
    outside = ~((found >= 0.0) & (found <= [width, height])).all(axis=1)
    found[outside] = np.nan
    return found.reshape(height, width, 2)


def _resampled(picture: NDArray[Any], pixels: NDArray[np.float64]) -> NDArray[Any]:
    """A picture [h, w, c] at places in it [h, w, 2], of its own type; 0 at those that are NaN."""
    height, width = picture.shape[:2]
    values = picture.astype(np.float32)
    known = ~np.isnan(pixels[..., 0])
    at = pixels[known] - 0.5
    first = np.floor(at).astype(np.int64)
    weights = _weights((at - first).astype(np.float32))
    columns = np.clip(first[:, :1] + np.arange(-1, 3), 0, width - 1)
    rows = np.clip(first[:, 1:] + np.arange(-1, 3), 0, height - 1)
    total = np.zeros((len(at), picture.shape[2]), np.float32)
    least, greatest = total + np.inf, total - np.inf
    for j in range(4):
        for i in range(4):
            taken = values[rows[:, j], columns[:, i]]
            total += (weights[:, 1, j] * weights[:, 0, i])[:, None] * taken
            if i in (1, 2) and j in (1, 2):
                least, greatest = np.minimum(least, taken), np.maximum(greatest, taken)
    total = np.clip(total, least, greatest)
    out = np.zeros_like(picture)
    out[known] = np.rint(total) if picture.dtype == np.uint8 else total
    return out


def _weights(t: NDArray[np.float32]) -> NDArray[np.float32]:
    """Keys' weights [..., 4] of the pixels at -1, 0, 1 and 2, for places t in [0, 1)."""
    a, b = t * t, t * t * t
    taps: Sequence[NDArray[np.float32]] = (
        -0.5 * t + a - 0.5 * b,
        1.0 - 2.5 * a + 1.5 * b,
        0.5 * t + 2.0 * a - 1.5 * b,
        -0.5 * a + 0.5 * b,
    )
    return np.stack(taps, axis=-1)
