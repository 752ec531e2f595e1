"""Defines the contract of backends: a backend estimates a RenderScene's radiance, and witnesses.

*Radiance*: how much light arrives at each pixel? Annotation is not its business: that is the exact
caster's (``scenec.backends.exact``), so a renderer never computes a label, an id or a depth.
*Witness*, which only checks ask for: which (row, face) does the renderer itself meet first through
each pixel's center? ``scenec check --backends`` holds it against the annotation.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenec.backends.stage.scene import Camera, RenderScene

#: ``Visibility.row`` where a ray meets nothing.
NO_ROW = -1
#: Light paths end after this many bounces in every renderer: sun or sky, the surface that is seen,
#: up to four surfaces between.
BOUNCES = 4


@dataclass(frozen=True)
class Rays:
    """A table of rays, in the world frame.

    Attributes:
        origins: float64 [n, 3], meters.
        directions: float64 [n, 3]; not normalized: its length is such that the ray parameter is
            planar depth for a pinhole camera (direction has z = 1 in the camera's frame); of lenses
            that look sideways and back, 1.
        shape: (height, width) of the picture the rays belong to; n = height * width, row-major.
        depth: Planar depth at a ray parameter of 1, float64 [n]; None: 1 for all.
        known: Which pixels have a ray, bool [n]; None: all. The others, outside of a lens's image
            circle, show nothing, whatever stands in ``directions``.
    """

    origins: NDArray[np.float64]
    directions: NDArray[np.float64]
    shape: tuple[int, int]
    depth: NDArray[np.float64] | None = None
    known: NDArray[np.bool_] | None = None


@dataclass(frozen=True)
class Visibility:
    """First hits of rays.

    Attributes:
        row: int32 [n]; NO_ROW: nothing.
        face: int32 [n].
        independent: Whether the renderer found them itself; the exact caster did otherwise.
    """

    row: NDArray[np.int32]
    face: NDArray[np.int32]
    independent: bool = True


@dataclass(frozen=True)
class Radiance:
    """Two independent halves of a Monte Carlo estimate, without directly seen sky and suns.

    Attributes:
        halves: Light from surfaces (premultiplied by coverage), float32 [2, h, w, 3].
        coverage: Fraction of each pixel (box filter) that surfaces cover, float32 [h, w].
        spp: Samples per pixel in both halves together.
        dropped: Samples whose light was negative or not finite (float32 slivers), counted as black.
        denoised: The mean of the halves after denoising, float32 [h, w, 3]; None unless asked for.
        denoised_halves: What it is the mean of, where each half was denoised apart, float32
            [2, h, w, 3]: they tell its error (``picture.noise.estimate_denoised``). None where they
            were not: its error is unknown.
        stochastic: Whether the halves' difference estimates the error. A rasterizer has no noise to
            estimate: its halves are equal, and its error is unknown.
        background: Sky and suns behind each half's surfaces, premultiplied, and both as haze lets
            them through, float32 [2, h, w, 3]: of a mean over several cameras
            (``picture.subframes``), each of which sees another sky. None, as backends return it:
            what is behind is drawn later.
    """

    halves: NDArray[np.float32]
    coverage: NDArray[np.float32]
    spp: int
    dropped: int = 0
    denoised: NDArray[np.float32] | None = None
    stochastic: bool = True
    background: NDArray[np.float32] | None = None
    denoised_halves: NDArray[np.float32] | None = None


@dataclass(frozen=True)
class LoadCost:
    """Bytes at the peak of loading a scene, measured (``lab/benchmarks/growth.py --of million``).

    Attributes:
        row: Of an instance of a mesh, where instances are kept.
        triangle: Of a triangle of a mesh, however many instances share it.
        written: Of a triangle of an instance, where instances are written out; 0: they never are.
        most_written: Of a scene, above which instances are kept all the same.
    """

    row: float
    triangle: float
    written: float = 0.0
    most_written: float = math.inf

    def keeps(self, scene: RenderScene) -> bool:
        """Whether instances of this scene are kept, not written out."""
        return not 0.0 < self.written * _triangles(scene)[1] <= self.most_written

    def of(self, scene: RenderScene) -> tuple[float, str]:
        """Bytes, and what for."""
        rows, (shared, written) = len(scene.rows.mesh), _triangles(scene)
        size = self.row * rows if self.keeps(scene) else self.written * written
        return (
            size + self.triangle * shared,
            f"{rows:,} rows, {written:,} triangles with all instances",
        )


def _triangles(scene: RenderScene) -> tuple[int, int]:
    """Counts the triangles of all meshes, and of all instances."""
    faces = np.array([len(mesh.faces) for mesh in scene.meshes], np.int64)
    return int(faces.sum()), int(faces[scene.rows.mesh].sum())


class Backend(ABC):
    """A renderer with a scene loaded. Made by ``scenec.backends.registry.open_backend``.

    A subclass takes one keyword, ``device``: one of its ``devices``, or "auto" for the fastest one
    that works here; it raises ``BackendError`` if that device does not work. It says what it can do
    by the class attributes below, and has at least ``version``, ``load`` and ``radiance``. A class
    that does not derive from this one gets from it what it lacks (``registry.backend_class``).

    Attributes:
        name: On the command line.
        devices: What ``--device`` takes beside "auto", such as ("cpu", "cuda").
        device: Where it runs: one of ``devices``.
        denoiser: Name of its denoiser; None if it has none, or its package is not installed.
        denoiser_extra: Extra of scenec that brings the denoiser, or None.
        follows_lenses: Whether ``radiance`` draws cameras with a lens by their own rays. Where it
            does not, it draws pinhole views, and ``picture.resample`` makes the picture of them.
        stochastic: Whether its radiance is a Monte Carlo estimate (``Radiance.stochastic``): what
            draws many pictures for one must know before the first.
        denoise: ``denoise(camera, sample, radiance, seed)`` gives a picture that it has drawn, or
            the mean of several, with ``denoised`` and ``denoised_halves``. None: each is denoised
            as it is drawn.
        continues: Whether ``radiance`` takes one more argument, ``first``: how many samples per
            pixel of the same seed were drawn before, which it goes on from. Pictures drawn so,
            weighed by their samples, have the error of one picture, which where samples are spread
            well is less than that of as many of seeds of their own.
        load_cost: Bytes that loading takes, by what is in the scene: what cannot fit is refused
            before. None: it does not say.
    """

    name: str
    devices: tuple[str, ...]
    device: str
    denoiser: str | None = None
    denoiser_extra: str | None = None
    follows_lenses: bool = False
    stochastic: bool = True
    denoise: Callable[[Camera, int, Radiance, int], Radiance] | None = None
    continues: bool = False
    load_cost: LoadCost | None = None

    def __init__(self, device: str = "auto") -> None:  # noqa: B027 (what needs no device needs none)
        """Starts the renderer."""

    @abstractmethod
    def version(self) -> str:
        """Returns name and version of renderer and variant, for sidecars and resume keys."""

    def warning(self) -> str | None:
        """Returns a line that the user should see before rendering, or None."""
        return None

    def losses(self, scene: RenderScene) -> tuple[str, ...]:
        """Lists what ``radiance`` leaves out of the scene's materials and lights, a line each.

        Asked once per batch, when ``rgb`` is wanted; shown as warnings and written to sidecars.
        """
        return ()

    @abstractmethod
    def load(self, scene: RenderScene) -> None:
        """Builds the renderer's own scene, once per batch."""

    @abstractmethod
    def radiance(
        self, camera: Camera, sample: int, spp: int, seed: int, denoise: bool = False
    ) -> Radiance:
        """Returns light that arrives, box-filtered over each pixel, in two halves of spp / 2 (up).

        Args:
            camera: The camera at this sample; a pinhole, unless ``follows_lenses``.
            sample: Time code.
            spp: Samples per pixel, at least 1.
            seed: Of the noise, 32 bits.
            denoise: Whether to fill ``Radiance.denoised``; only asked of backends with a denoiser.
        """

    def witness(self, rays: Rays, sample: int, camera: Camera | None = None) -> Visibility | None:
        """Returns first hits as this renderer itself finds them.

        Args:
            rays: One a pixel. Hits of pixels without a ray are of no meaning.
            sample: Time code.
            camera: The pinhole camera the rays come from; None for a table of another kind, such
                as of a camera with a lens.

        Returns:
            The hits, back faces too; None if the backend does not tell, or cannot follow such rays
            (a rasterizer and rays of no pinhole).
        """
        return None


def completed(kind: type) -> type[Backend]:
    """Returns a backend's class, or, if it does not derive from ``Backend``, a subclass of both."""
    return kind if issubclass(kind, Backend) else type(kind.__name__, (kind, Backend), {})
