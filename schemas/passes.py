"""Passes: what each holds, how it stands in frames, and which packages offer more of them.

A package adds one with an entry point in the group ``scenec.passes``: its name is the pass's, its
value a ``scenec.backends.annotation.contract.Pass``. Nothing is imported to know that it is there.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Literal

from scenec.schemas import plugins
from scenec.schemas.depth_camera import MEASURED

#: Entry points of other packages.
GROUP = "scenec.passes"

#: In place of a backend's name: annotation alone, which needs no renderer; and its spellings.
ANNOTATION = "annotation"
ANNOTATION_NAMES = (ANNOTATION, "reference")

#: The pass that is a file of its own (``scenec.schemas.amodal``), and the one of each label level.
AMODAL, LABEL = "amodal", "label"


@dataclass(frozen=True, kw_only=True)
class PassFormat:
    """Describes a pass's values and their storage in a frame's EXR.

    Attributes:
        name: Of the pass and of its part of the file.
        channels: Of each pixel, in the order of the array's last axis; none: it is no part of the
            EXR.
        dtype: On disk.
        convention: What the values are, with their unit, for sidecars.
    """

    name: str
    channels: tuple[str, ...]
    dtype: Literal["float32", "uint32"] = "float32"
    convention: str

    @property
    def channel_names(self) -> tuple[str, ...]:
        """Names of the channels in the file; viewers know those of ``rgb`` and ``depth``."""
        if self.name in ("rgb", "depth"):
            return self.channels
        return tuple(f"{self.name}.{channel}" for channel in self.channels)


_CODES = (
    "what the other picture shows of the point: 0 visible, 1 hidden by something, "
    "2 outside of the picture or behind the camera, 3 nothing to compare with"
)
_FLOW = (
    "pixels right and down from the pixel's center to where its point is in the same camera's "
    "picture at the {} sample; of the sky: as if infinitely far away; NaN where it is behind the "
    "camera then, or there is no such sample"
)


def _ids(name: str, convention: str) -> PassFormat:
    return PassFormat(name=name, channels=("id",), dtype="uint32", convention=convention)


def _floats(name: str, channels: str, convention: str) -> PassFormat:
    return PassFormat(name=name, channels=tuple(channels), convention=convention)


#: Ours by name, in the order in which messages list them.
BUILT_IN: dict[str, PassFormat] = {
    one.name: one
    for one in (
        _floats("rgb", "RGB", "linear Rec.709 radiance, mean over the pixel's area (box filter)"),
        _ids(LABEL, "id at the pixel's center; 0 is no label"),
        _ids("instance", "id at the pixel's center; 0 is no instance"),
        _floats(
            "depth", "Z", "meters along the optical axis, at the pixel's center; +inf without a hit"
        ),
        _floats("range", "Z", "meters along the ray, at the pixel's center; +inf without a hit"),
        _floats("normal", "XYZ", "geometric, world frame, facing the camera; 0 without a hit"),
        _floats("position", "XYZ", "world frame, meters; NaN without a hit"),
        _floats(
            "slope",
            "S",
            "degrees between the face's plane and the horizontal one; NaN without a hit",
        ),
        PassFormat(
            name="traversable",
            channels=("class",),
            dtype="uint32",
            convention="what the place is to the vehicle of the sensor: 0 unknown or no hit, "
            "1 traversable, 2 caution, 3 hazard",
        ),
        _ids("face", "index of the authored face; 4294967295 without a hit"),
        _floats(
            AMODAL,
            "",
            "file of masks, one an instance: pixels whose center would show it if nothing stood "
            "before it",
        ),
        _floats("flow", "UV", _FLOW.format("next")),
        _floats(
            "scene_flow",
            "XYZ",
            "what the pixel's center shows, next sample minus this one, each in the camera's own "
            "frame of then, meters; NaN without a hit",
        ),
        _ids("occlusion", f"at the next sample, {_CODES}"),
        _floats("flow_backward", "UV", _FLOW.format("previous")),
        _ids("occlusion_backward", f"at the previous sample, {_CODES}"),
        _floats(
            "disparity",
            "U",
            "column of the pixel's center minus column of its point in the picture of the camera's "
            "partner; NaN where that camera has it behind",
        ),
        _ids("disparity_occlusion", f"of the camera's partner, {_CODES}"),
        _floats(
            MEASURED,
            "Z",
            "what the sensor's depth camera says, meters along the optical axis; 0: no answer",
        ),
    )
}

#: Passes as they are asked for; ``label`` stands for all levels.
PASSES = tuple(BUILT_IN)


def built_in(name: str) -> PassFormat | None:
    """The format of one of ours; ``label.<level>`` is one."""
    kind, _, level = name.partition(".")
    if level:
        return replace(BUILT_IN[LABEL], name=name) if kind == LABEL else None
    return BUILT_IN.get(name)


def pass_names() -> tuple[str, ...]:
    """Names of all passes that could be asked for; ours first."""
    return (*PASSES, *(name for name in plugins.names_of(GROUP) if name not in BUILT_IN))


def is_pass(name: str) -> bool:
    """Whether there is such a pass, as it is asked for: ours, or another package's."""
    return name in BUILT_IN or bool(plugins.entry_points_of(GROUP, name))


def origins(names: Iterable[str]) -> dict[str, str]:
    """Package and version that passes of others come from, by name; ours have none."""
    return plugins.origins(GROUP, (name for name in names if built_in(name) is None))
