"""What must hold between the keys of poses: names of objects, alternatives, regions."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from scenec.compiler.cfg.faults import Finding
from scenec.compiler.cfg.json_positions import Path
from scenec.schemas.spelling import nearest, shown


def check_poses(document: Any, spans: Mapping[Path, tuple[float, float]]) -> Iterator[Finding]:
    """Findings on the rigs' poses.

    Args:
        document: A cfg, perhaps with faults.
        spans: Smallest and largest value of each sound number, by path.
    """
    cfg = document if isinstance(document, dict) else {}
    rigs = cfg.get("rigs")
    for rig, node in rigs.items() if isinstance(rigs, dict) else ():
        pose = node.get("pose") if isinstance(node, dict) else None
        if not isinstance(pose, dict):
            continue
        path: Path = ("rigs", rig, "pose")
        yield from _check_objects(cfg, pose, path)
        yield from _check_sampling(cfg, pose, path)
        yield from _check_track(pose, path)
        yield from _check_bounds(pose, path, spans)


def _check_objects(cfg: Mapping[str, Any], pose: dict[str, Any], path: Path) -> Iterator[Finding]:
    known = cfg.get("objects", {})
    for key in ("center", "look"):
        aim = pose.get(key)
        name = aim.get("object") if isinstance(aim, dict) and aim.get("type") == "object" else None
        if isinstance(name, str) and isinstance(known, dict) and name not in known:
            yield Finding(
                (*path, key, "object"),
                f"no class of objects {shown(name)}{nearest(name, known)}",
            )


def _check_sampling(cfg: Mapping[str, Any], pose: dict[str, Any], path: Path) -> Iterator[Finding]:
    sampling = pose.get("sampling")
    if not isinstance(sampling, dict):
        return
    for key in ("rate_hz", "start_s"):
        if key in sampling and "times_s" in sampling:
            yield Finding(
                (*path, "sampling", "times_s"),
                f"{key} and times_s both say when the samples are: take one away",
                at_key=True,
            )
    times, samples = sampling.get("times_s"), cfg.get("samples", 1)
    if isinstance(times, list) and isinstance(samples, int) and len(times) != samples:
        yield Finding(
            (*path, "sampling", "times_s"),
            f"{len(times)} times for {samples} samples: expected one for each",
        )
    if isinstance(times, list) and all(isinstance(t, (int, float)) for t in times):
        for i in range(1, len(times)):
            if times[i] <= times[i - 1]:
                yield Finding(
                    (*path, "sampling", "times_s", i),
                    f"{shown(times[i])} after {shown(times[i - 1])}: expected times that rise",
                )
                break


def _check_track(pose: dict[str, Any], path: Path) -> Iterator[Finding]:
    if pose.get("type") != "track":
        return
    if (pose.get("format") == "oaisys") != ("frame_rate_hz" in pose):
        if "frame_rate_hz" in pose:
            yield Finding(
                (*path, "frame_rate_hz"),
                'only the format "oaisys" counts frames, others have times: take it away',
                at_key=True,
            )
        else:
            yield Finding(
                (*path, "format"),
                'the format "oaisys" counts frames: expected the key frame_rate_hz beside it',
            )
    for key, needed in (
        ("interpolation", "sampling"),
        ("max_gap_s", "sampling"),
        ("gaps", "max_gap_s"),
    ):
        if key in pose and needed not in pose:
            yield Finding(
                (*path, key),
                f"{key} says nothing without {needed}: give that, too, or take it away",
                at_key=True,
            )


def _check_bounds(
    pose: dict[str, Any], path: Path, spans: Mapping[Path, tuple[float, float]]
) -> Iterator[Finding]:
    limits = pose.get("limits")
    for name in ("distance_m", "elevation_deg", "incidence_deg"):
        at = (*path, "limits")
        low, high = (spans.get((*at, f"{end}_{name}")) for end in ("min", "max"))
        if isinstance(limits, dict) and low and high and low[0] > high[1]:
            yield Finding(
                (*at, f"min_{name}"),
                f"{low[0]:g} is above max_{name} ({high[1]:g}): nothing lies between",
            )
    low, high = (spans.get((*path, f"{end}_height_m")) for end in ("touchdown", "entry"))
    # The default counts, too: its bounds are those of the schema's.
    if pose.get("type") == "descent" and high and (low or (1.0, 1.0))[1] > high[0]:
        yield Finding(
            (*path, "entry_height_m"),
            f"{high[0]:g} m can be below touchdown_height_m ({(low or (1.0, 1.0))[1]:g} m): "
            "expected it above",
        )
