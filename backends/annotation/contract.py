"""Defines passes and the views of a scene that they are computed from.

A pass is a function of first hits: of each ray, or of a whole picture. What one makes on its way,
another has through ``View.once``; nothing is made that no pass asks for.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from scenec.backends.annotation.instances import FrameInstances, Instances
from scenec.backends.camera.shutter import is_rolling
from scenec.backends.contract import Rays
from scenec.backends.exact.caster import ExactCaster, Hits
from scenec.backends.stage.scene import Camera, Mesh, RenderScene
from scenec.schemas.kernels import kernel
from scenec.schemas.passes import BUILT_IN, PassFormat
from scenec.schemas.threads import over_threads


@kernel
def _gather(first, last, start, row, face, values, missing, out):  # type: ignore[no-untyped-def]
    """A value per face, or ``missing`` where nothing is hit."""
    for k in range(first, last):
        out[k] = missing if row[k] < 0 else values[start[row[k]] + face[k]]


class View:
    """Holds the first hits of rays: of a picture, of a tile of its rows, of a lidar's scan.

    Args:
        scene: The stage.
        sample: Time code.
        hits: First hits of the rays, n of them.
        rays: Makes the rays, when they are first asked for.
    """

    def __init__(
        self, scene: RenderScene, sample: int, hits: Hits, rays: Callable[[], Rays]
    ) -> None:
        self.scene, self.sample, self.hits = scene, sample, hits
        self._rays = rays
        self._made: dict[Callable[..., Any], Any] = {}

    @cached_property
    def rays(self) -> Rays:
        """The rays. Their parameter is planar depth, or what ``Rays.depth`` makes of it."""
        return self._rays()

    def once[T](self, make: Callable[[Self], T]) -> T:
        """Returns a function's result for this view, computed once for all passes."""
        if make not in self._made:
            self._made[make] = make(self)
        value: T = self._made[make]
        return value

    def of_faces(
        self, values: Callable[[Mesh], NDArray[np.uint32]], missing: int
    ) -> NDArray[np.uint32]:
        """The value of the face that each ray meets, uint32 [n].

        Args:
            values: Of each face of a mesh.
            missing: Where a ray meets nothing.
        """
        hits = self.hits
        tables = [np.empty(0, np.uint32), *(values(mesh) for mesh in self.scene.meshes)]
        table = np.concatenate(tables).astype(np.uint32, copy=False)
        out = np.empty(len(hits.row), np.uint32)
        starts, nothing = hits.geometry.row_face, np.uint32(missing)
        over_threads(_gather, len(out), starts, hits.row, hits.face, table, nothing, out)
        return out


class Picture(View):
    """A whole picture, its camera, and a caster for rays of one's own.

    Args:
        scene, sample, hits, rays: As of a ``View``.
        camera: Whose picture it is.
        caster: Posed as at the sample; whoever poses it otherwise puts it back.
        masks: Whether amodal masks are asked for.
        instances: Of the scene; made when they are asked for, unless given.
    """

    def __init__(
        self,
        scene: RenderScene,
        sample: int,
        hits: Hits,
        rays: Callable[[], Rays],
        camera: Camera,
        caster: ExactCaster,
        masks: bool = False,
        instances: Instances | None = None,
    ) -> None:
        super().__init__(scene, sample, hits, rays)
        self.camera, self.caster = camera, caster
        self._masks, self._instances = masks, instances

    def put(self, make: Callable[[Any], NDArray[Any]], pixels: slice, values: NDArray[Any]) -> None:
        """Keep what was computed of a band's pixels, so that ``once`` need not compute it."""
        if make not in self._made:
            self._made[make] = np.empty((len(self.hits.row), *values.shape[1:]), values.dtype)
        self._made[make][pixels] = values

    @cached_property
    def seen(self) -> FrameInstances:
        """Returns the picture's table of instances, and amodal masks if they were requested."""
        camera, hits = self.camera, self.hits
        # A pinhole's rays need not be made: their parameter is depth.
        rays = self.rays if camera.lens is not None or is_rolling(camera) else None
        return (self._instances or Instances(self.scene)).seen(
            hits.row, hits.t, camera, self.sample, hits.geometry, self._masks, rays
        )


@dataclass(frozen=True, kw_only=True)
class Pass(PassFormat):
    """A pass: its format (``scenec.schemas.passes``), and how it is computed.

    Attributes:
        compute: Of a ``View``, or with ``whole`` of a ``Picture``: a value a ray, [n], or
            [n, channels] of several channels; float32 or float64 for ``dtype`` float32 (frames hold
            float32), uint32 for uint32. Large pictures are given band by band.
        whole: Whether it needs the whole picture, its camera, or the caster.
        needs: Names of passes that a frame has where it has this one.
    """

    compute: Callable[..., Any]
    whole: bool = False
    needs: tuple[str, ...] = ()


def built_in(name: str, compute: Callable[..., Any], **more: Any) -> Pass:
    """One of ours, whose format all parts of scenec know."""
    return Pass(**asdict(BUILT_IN[name]), compute=compute, **more)
