"""What must hold between the keys of rigs' poses."""

from __future__ import annotations

import math
from collections.abc import Iterator

from scenec.compiler.kinds.finding import Finding
from scenec.compiler.kinds.node import Node, off_terrain, unknown
from scenec.schemas.spelling import shown


def check_rigs(cfg: Node) -> Iterator[Finding]:
    """Findings on all rigs."""
    for rig in cfg.each("rigs", "*"):
        pose = rig.at("pose")
        yield from _check_position(cfg, pose)
        yield from _check_aims(cfg, pose)
        yield from _check_sampling(cfg, pose)
        yield from _check_track(pose)
        yield from _check_bounds(pose)


def _check_position(cfg: Node, pose: Node) -> Iterator[Finding]:
    position = pose.at("position")
    for key, how in off_terrain(cfg, position):
        unbounded = any(map(math.isinf, position.span(key) or ()))
        hint = " (give the distribution min and max)" if unbounded else ""
        yield position.fault(f"{how}: expected a position on it{hint}", key)


def _check_aims(cfg: Node, pose: Node) -> Iterator[Finding]:
    objects = cfg.at("objects")
    for aim in (pose.at("center"), pose.at("look")):
        name = aim["object"]
        known = objects or "objects" not in cfg
        if known and name is not None and name not in objects:
            yield aim.fault(unknown("class of objects", name, objects.entries), "object")


def _check_sampling(cfg: Node, pose: Node) -> Iterator[Finding]:
    sampling, samples = pose.at("sampling"), cfg["samples"]
    for key in ("rate_hz", "start_s"):
        yield from sampling.both(key, "times_s", "when the samples are")
    times = sampling["times_s"]
    if times is None:
        return
    if samples is not None and len(times) != samples:
        yield sampling.fault(
            f"{len(times)} times for {samples} samples: expected one for each", "times_s"
        )
    for i in range(1, len(times)):
        if times[i] <= times[i - 1]:
            yield sampling.fault(
                f"{shown(times[i])} after {shown(times[i - 1])}: expected times that rise",
                "times_s",
                i,
            )
            break


def _check_track(pose: Node) -> Iterator[Finding]:
    if pose["type"] != "track":
        return
    if (pose["format"] == "oaisys") != ("frame_rate_hz" in pose):
        if "frame_rate_hz" in pose:
            yield pose.key_fault(
                'only the format "oaisys" counts frames, others have times: take it away',
                "frame_rate_hz",
            )
        else:
            yield pose.fault(
                'the format "oaisys" counts frames: expected the key frame_rate_hz beside it',
                "format",
            )
    needs = {"interpolation": "sampling", "max_gap_s": "sampling", "gaps": "max_gap_s"}
    for key, needed in needs.items():
        if key in pose and needed not in pose:
            yield pose.key_fault(
                f"{key} says nothing without {needed}: give that, too, or take it away", key
            )


def _check_bounds(pose: Node) -> Iterator[Finding]:
    limits = pose.at("limits")
    for name in ("distance_m", "elevation_deg", "incidence_deg"):
        low, high = limits.span(f"min_{name}"), limits.span(f"max_{name}")
        if low and high and low[0] > high[1]:
            yield limits.fault(
                f"{low[0]:g} is above max_{name} ({high[1]:g}): nothing lies between", f"min_{name}"
            )
    high, low = pose.span("entry_height_m"), pose.span("touchdown_height_m")
    if pose["type"] == "descent" and high:
        # The default counts, too: its bounds are those of the schema's.
        lowest = low[1] if low else 1.0
        if lowest > high[0]:
            yield pose.fault(
                f"{high[0]:g} m can be below touchdown_height_m ({lowest:g} m): expected it above",
                "entry_height_m",
            )
