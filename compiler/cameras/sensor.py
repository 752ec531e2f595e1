"""Declares cameras, and draws them."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import astuple, dataclass
from typing import TYPE_CHECKING, ClassVar, Final

from scenec.compiler.cameras.mount import Mount, Trigger
from scenec.compiler.geometry.lenses import sound_intrinsics
from scenec.compiler.kinds import Context, Finding, Node, an, bounded, draw_kind, key, list_of
from scenec.compiler.kinds.forms import (
    ANGLE_PER_BATCH,
    COUNT,
    OUTPUT,
    PER_BATCH,
    TEXT,
    one_of,
)
from scenec.schemas.codec import JsonObject
from scenec.schemas.correspondence import PARTNER
from scenec.schemas.depth_camera import MEASURED
from scenec.schemas.errors import SceneError
from scenec.schemas.lens import EQUIRECTANGULAR
from scenec.schemas.plugins import origin
from scenec.schemas.presets import PRESETS
from scenec.schemas.shutter import Shutter
from scenec.schemas.spelling import nearest, shown
from scenec.schemas.vehicle import Vehicle

if TYPE_CHECKING:
    from scenec.compiler.cameras.exposure import ShutterKeys as Opening
    from scenec.compiler.cameras.imaging import ImagingKeys, ImagingPlan
    from scenec.compiler.cameras.lens import FocusKeys
    from scenec.compiler.cameras.vehicle import VehicleKeys
    from scenec.compiler.scene import rig


#: Of a sensor without a lens that may look behind itself.
_FIELD_OF_VIEW: Final = {
    "if": {
        "properties": {"lens": {
            "properties": {"type": {"enum": ["kannala_brandt", "equirectangular"]}},
            "required": ["type"]
        }},
        "required": ["lens"]
    },
    "else": {"properties": {"fov_deg": bounded(ANGLE_PER_BATCH, above=0, below=180).but(
        description="Horizontal field of view, with square pixels and a centered principal point."
    ).keywords}}
}  # fmt: skip


@dataclass(frozen=True)
class SensorPlan:
    """A sensor, but for what depends on light and motion.

    Attributes:
        sensor: Without imaging and shutter; its exposure is absolute, or relative to the incident
            light's if ``metered``. An automatic one is metered, too: what it is before there are
            pictures.
        metered: Whether the exposure follows the light.
        imaging: What it makes of light, or None.
        shutter: At each sample, or None.
    """

    sensor: rig.Sensor
    metered: bool
    imaging: ImagingPlan | None = None
    shutter: tuple[Shutter, ...] | None = None


@dataclass(frozen=True, kw_only=True)
class Intrinsics:
    """u = fx X/Z + skew Y/Z + cx, v = fy Y/Z + cy; the center of the top left pixel is
    (0.5, 0.5).
    """

    EXAMPLE: ClassVar = {"fx": 520, "fy": 520, "cx": 320, "cy": 240}

    KEYWORDS: ClassVar = {"x-whole": True}

    fx: float = key(PER_BATCH, at_least=0.001, at_most=1_000_000_000, unit="px")
    """Focal length in x."""
    fy: float = key(PER_BATCH, at_least=0.001, at_most=1_000_000_000, unit="px")
    """Focal length in y."""
    cx: float = key(PER_BATCH, at_least=-10_000_000, at_most=10_000_000, unit="px")
    """Principal point in x."""
    cy: float = key(PER_BATCH, at_least=-10_000_000, at_most=10_000_000, unit="px")
    """Principal point in y."""
    skew: float = key(PER_BATCH, default=0, at_least=-10_000_000, at_most=10_000_000, unit="px")
    """Skew."""


@dataclass(frozen=True, kw_only=True)
class SensorKeys:
    """A camera. Give fov_deg or intrinsics, or neither for a panorama of the whole sphere. With a
    preset, give only what differs.
    """

    EXAMPLE: ClassVar = {"resolution": [640, 480], "fov_deg": 65}

    KEYWORDS: ClassVar = {
        "if": {"required": ["preset"]},
        "then": _FIELD_OF_VIEW,
        "else": {"required": ["resolution"], **_FIELD_OF_VIEW},
    }

    preset: str | None = key(one_of(*PRESETS), sparse=True)
    """A camera that people own: its keys, unless given here; null removes one."""
    resolution: tuple[int, int] = key(
        list_of(bounded(COUNT, at_least=1, at_most=65_535), "Pixels along one axis.", count=2),
        optional=True,
        unit="px",
    )
    """Width and height of the picture."""
    fov_deg: float | None = key(
        ANGLE_PER_BATCH.but(**{"x-usual-minimum": 4}), optional=True, above=0, at_most=360
    )
    """Horizontal field of view, with square pixels and a centered principal point; up to 360 with
    kannala_brandt and equirectangular."""
    intrinsics: Intrinsics | None = key(an("intrinsics", drawn=True), optional=True)
    """Intrinsics."""
    lens: JsonObject | None = key(an("lens"), sparse=True)
    """How the lens bends the picture; left out, a pinhole."""
    mount: Mount = key(an("mount", drawn=True), default={})
    """Where the sensor sits on the rig."""
    exposure: JsonObject = key(an("exposure"), default={"type": "auto"})
    """Exposure of the 8-bit picture."""
    imaging: ImagingKeys | None = key(an("imaging", drawn=True), sparse=True)
    """Optics, noise and processing of a real camera; left out, none."""
    effects: tuple[JsonObject, ...] | None = key(list_of(an("effect"), least=1), sparse=True)
    """What other packages do to the picture last, in order; rgb stays."""
    focus: FocusKeys | None = key(an("focus", drawn=True), sparse=True)
    """What is sharp, and how shallow; left out, everything is sharp."""
    shutter: Opening | None = key(an("shutter", drawn=True), sparse=True)
    """When each row is exposed: motion blur, rolling shutter; left out, one instant."""
    trigger: Trigger | None = key(an("trigger", drawn=True), sparse=True)
    """Samples at which it takes a frame; left out, all."""
    depth_camera: JsonObject | None = key(an("depth_camera"), sparse=True)
    """How the sensor measures depth, for the output depth_measured."""
    vehicle: VehicleKeys | None = key(an("vehicle", drawn=True), sparse=True)
    """Whom the output traversable is for; left out, about a Mars Exploration Rover."""
    partner: str | None = key(TEXT, sparse=True)
    """Another sensor of the rig that disparity goes to. The pair must be rectified: alike but for
    position along rows and the principal point's column. scenec export --rectify makes one of any
    two side by side."""
    outputs: tuple[str, ...] = key(list_of(OUTPUT, least=1, unique=True), optional=True)
    """This sensor's channels; left out, those of the cfg."""

    @staticmethod
    def check(node: Node) -> Iterator[Finding]:
        """Finds what does not go together."""
        say = node.both if node.at("lens")["type"] == EQUIRECTANGULAR else node.either
        yield from say("fov_deg", "intrinsics", "what the sensor sees")
        yield from _check_outputs(node)

    def draw(self, context: Context) -> SensorPlan:
        """Returns the camera, which has the name that its path ends with.

        Raises:
            SceneError: Its lens is not one-to-one, its imaging is none, or it is to focus nearer
                than its focal length.
        """
        # Imported here: a check does without.
        from scenec.compiler.scene import rig

        path, samples = context.path, context.samples
        lens = focus = depth = imaging = opened = None
        if self.lens is not None:
            lens = draw_kind("lens", self.lens, f"{path}/lens", context).build()
        given = None if self.intrinsics is None else astuple(self.intrinsics)
        intrinsics = sound_intrinsics(lens, self.resolution, self.fov_deg, given)
        if isinstance(intrinsics, str):
            raise SceneError(f"{path}/lens: {intrinsics}")
        exposure = draw_kind("exposure", self.exposure, f"{path}/exposure", context)
        if self.imaging is not None:
            imaging = self.imaging.draw(context.at(f"{path}/imaging"))
        if self.focus is not None:
            focus = self.focus.draw(context.at(f"{path}/focus"), intrinsics[0], imaging)
        if self.depth_camera is not None:
            depth = draw_kind("depth_camera", self.depth_camera, f"{path}/depth_camera", context)
        if self.shutter is not None:
            opened = self.shutter.at_samples(samples, imaging)
        sensor = rig.Sensor(
            name=path.rpartition("/")[2],
            resolution=self.resolution,
            intrinsics=intrinsics,
            to_rig=self.mount.to_rig,
            exposure_ev=exposure.at_samples(context.at(f"{path}/exposure")),
            outputs=self.outputs,
            exposure_per=exposure.per,
            partner=self.partner,
            trigger=astuple(self.trigger or Trigger()),
            depth_camera=depth,
            lens=lens,
            # Light alone is blurred.
            focus=focus if "rgb" in self.outputs else None,
            effects=tuple(
                _effect(effect, context.at(f"{path}/effects/{i}"))
                for i, effect in enumerate(self.effects or ())
            ),
            vehicle=None if self.vehicle is None else Vehicle(**vars(self.vehicle)),
        )
        return SensorPlan(sensor, exposure.METERED, imaging, opened)


def _effect(node: JsonObject, context: Context) -> str:
    """See ``rig.Sensor.effects``."""
    kind = node["type"]
    found = {"type": kind, "from": origin("scenec.effects", kind), "key": context.key()}
    return json.dumps({**found, **node})


def _check_outputs(node: Node) -> Iterator[Finding]:
    """Outputs that need more than a camera: a stereo partner, a way of measuring depth."""
    asks = node if "outputs" in node else node.whole()
    place = (*asks.path, "outputs") if asks is node else node.path
    asked = asks["outputs"]
    outputs = asked or ()
    if MEASURED in outputs and "depth_camera" not in node:
        yield Finding(place, f"the output {shown(MEASURED)} needs the key depth_camera")
    for use, output in (("depth_camera", MEASURED), ("vehicle", "traversable")):
        if use in node and "outputs" in asks and asked and output not in asked:
            yield node.key_fault(
                f"nothing reads it: the output {shown(output)} is not asked for", use
            )
    partner, name = node["partner"], node.path[-1]
    if partner is not None:
        sensors = node.whole().at(*node.path[:-1])
        if partner == name:
            yield node.fault("a sensor is no partner of itself", "partner")
        elif partner not in sensors:
            others = [other for other in sensors.entries if other != name]
            yield node.fault(
                f"the rig has no sensor {shown(partner)}{nearest(partner, others)}", "partner"
            )
        return
    pairs = [one for one in outputs if one in PARTNER]
    if pairs and "partner" not in node:
        yield Finding(
            place, f"the output {shown(pairs[0])} needs the key partner: the sensor it goes to"
        )
