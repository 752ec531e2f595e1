"""The ``reference`` backend: visibility by the exact ray caster, which defines annotation."""

from __future__ import annotations

from scenec.backends.contract import Radiance, Rays, Visibility
from scenec.backends.exact import ExactCaster
from scenec.backends.memory import LoadCost
from scenec.backends.render_scene import Camera, RenderScene
from scenec.schemas.errors import BackendError, CameraRefusedError
from scenec.schemas.versions import version_of


class Reference:
    """A backend with exact visibility and no radiance. Implements ``contract.Backend``.

    Attributes:
        caster: The loaded scene's exact caster, or None before ``load``.
    """

    name = "reference"
    devices = ("cpu",)
    denoiser = None
    follows_lenses = False
    load_cost = LoadCost(row=600.0, triangle=100.0)

    def __init__(self, device: str = "auto") -> None:
        self.device = "cpu"
        self.caster: ExactCaster | None = None

    def version(self) -> str:
        """Name and version, for sidecars and resume keys."""
        return f"reference (scenec {version_of()})"

    def warning(self) -> str | None:
        """Nothing to warn of."""
        return None

    def losses(self, scene: RenderScene) -> tuple[str, ...]:
        """Nothing: there is no light to lose any of."""
        return ()

    def load(self, scene: RenderScene) -> None:
        """Build the hierarchies of a scene.

        Raises:
            BackendError: The scene's arrays are broken.
        """
        self.caster = ExactCaster(scene)

    def visibility(self, rays: Rays, sample: int, camera: Camera | None = None) -> Visibility:
        """First hits, exact.

        Raises:
            BackendError: No scene is loaded.
        """
        if self.caster is None:
            raise BackendError("reference: no scene is loaded; call load first")
        self.caster.pose(sample)
        row, face, _ = self.caster.cast(rays)
        return Visibility(row, face)

    def radiance(
        self, camera: Camera, sample: int, spp: int, seed: int, denoise: bool = False
    ) -> Radiance:
        """Always an error: the exact ray caster carries no light.

        Raises:
            BackendError: Always.
        """
        raise CameraRefusedError(
            "reference renders annotation only, no rgb; leave rgb out of --passes, "
            "or use --backend mitsuba"
        )
