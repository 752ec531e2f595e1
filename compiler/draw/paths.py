"""Draws motions, or reads them."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.assets.tracks import Stamped, read_stamped, read_track
from scenec.compiler.cameras.paths.descent import Descent
from scenec.compiler.cameras.paths.lawn_mower import LawnMower
from scenec.compiler.cameras.paths.mav import Mav
from scenec.compiler.cameras.paths.motion import Motion
from scenec.compiler.cameras.paths.orbit import ObjectAim, Orbit, PointAim
from scenec.compiler.cameras.paths.random_pose import Limits, Look, RandomPose
from scenec.compiler.cameras.paths.random_target import RandomTarget
from scenec.compiler.cameras.paths.rover import Rover
from scenec.compiler.cameras.tracks import Gaps, Sampling, TrackPlan, TrackWay, resampled
from scenec.compiler.cfg.load import Spec
from scenec.compiler.distributions.resolve import per_sample, resolve
from scenec.compiler.distributions.streams import Streams
from scenec.compiler.draw.of_keys import of_keys
from scenec.compiler.geometry.poses import compose, from_quaternion
from scenec.compiler.geometry.se3 import matrices
from scenec.compiler.kinds.context import Context
from scenec.schemas import stage as names
from scenec.schemas.plugins import Kinds

#: Candidates of each goal of a drive.
_GOAL_TRIES = 64
_OURS = ("random", "orbit", "lawn_mower", "descent", "rover", "mav")
_OTHERS = Kinds[type[Any]]("scenec.poses", {})
_HALF_TURN = np.diag([*names.HALF_TURN, 1.0])


def draw_track(
    spec: Spec,
    cfg: dict[str, Any],
    path: str,
    streams: Streams,
    samples: int,
    between: bool = False,
) -> TrackPlan:
    """Poses from a file; ``between``: whether they are asked for between the samples, too.

    Raises:
        SceneError: The file is none, or does not reach as far as is asked for.
    """
    file = spec.files[f"{path}/file"].path
    what, usd = f"{path}: {file.name}", cfg["convention"] == "usd"
    sampling = resolve(cfg.get("sampling"), streams, f"{path}/sampling")
    form = cfg.get("format", "csv")
    gaps = Gaps(cfg.get("max_gap_s"), cfg.get("gaps") == "hold")
    method = cfg.get("interpolation", "linear")
    if sampling is None and form == "csv" and "quaternion" not in cfg:
        track = read_track(file)
        rows = [from_quaternion(track.position_m[i], track.quaternion[i]) for i in range(samples)]
        to_world = np.stack([compose(m, _HALF_TURN) for m in rows] if usd else rows)
        begin = float(track.time_s[0])
        stamped = Stamped(track.time_s - begin, begin, track.position_m, track.quaternion, ())
        at, times = stamped.time_s[:samples], track.time_s[:samples]
    else:
        stamped = read_stamped(file, form, cfg.get("quaternion"), cfg.get("frame_rate_hz"))
        if sampling is None:
            at = stamped.time_s[:samples]
            to_world = matrices(stamped.position_m[:samples], stamped.quaternion[:samples])
            to_world = to_world * np.diag(_HALF_TURN) if usd else to_world
        else:
            at = _sampling(sampling).times(float(stamped.time_s[-1]), samples, what)
            to_world = resampled(stamped, at, method, gaps, what, usd)
        times = stamped.begin_s + at
    way = TrackWay(at, stamped, method, gaps, what, usd) if between else None
    return TrackPlan(to_world, times, way)


def draw_random_target(
    cfg: dict[str, Any], path: str, streams: Streams, samples: int
) -> RandomTarget:
    """Places and targets of every sample."""

    def drawn(*keys: str) -> NDArray[np.float64]:
        node: Any = cfg
        for key in keys:
            node = node[key]
        return per_sample(node, streams, "/".join((path, *keys)), samples)

    return RandomTarget(
        xy=np.stack([drawn("position", "x_m"), drawn("position", "y_m")], axis=1),
        height_m=drawn("position", "height_m"),
        distance_m=drawn("target", "distance_m"),
        bearing_deg=drawn("target", "bearing_deg"),
        target_height_m=drawn("target", "height_m"),
        roll_deg=drawn("roll_deg"),
    )


def draw_motion(cfg: dict[str, Any], path: str, setting: Context) -> Motion:
    """A made motion: numbers of the batch are drawn, those of each try get a key."""
    streams = setting.streams
    node = resolve(cfg, streams, path)
    if node["type"] not in _OURS:
        node["sampling"] = _sampling(node["sampling"])
        made: Motion = of_keys(_OTHERS, node, path, setting)
        return made
    kind = node.pop("type")
    if kind == "random":
        return _random(node, path, streams)
    sampling = _sampling(node.pop("sampling"))
    if kind == "orbit":
        return Orbit(**node | {"center": _aim(node["center"], path, streams)}, sampling=sampling)
    if kind == "lawn_mower":
        return LawnMower(**node, sampling=sampling)
    if kind == "descent":
        return Descent(**node, sampling=sampling)
    goals, given = node.pop("goals"), node.pop("waypoints_m")
    waypoints = np.array(given, np.float64) if given is not None else np.empty((0, 2))
    if kind == "rover":
        count = 0 if len(waypoints) else goals
        u = streams.uniforms(f"{path}/goals", 2 * count * _GOAL_TRIES).reshape(-1, 2)
        return Rover(waypoints, u.reshape(count, _GOAL_TRIES, 2), **node, sampling=sampling)
    margin = node.pop("margin")
    if not len(waypoints):
        u = streams.uniforms(f"{path}/goals", 2 * goals).reshape(-1, 2)
        return Mav(waypoints, (u - 0.5) * (1.0 - 2.0 * margin), **node, sampling=sampling)
    return Mav(waypoints, np.empty((0, 2)), **node, sampling=sampling)


def _sampling(node: dict[str, Any]) -> Sampling:
    times = node["times_s"]
    return Sampling(
        node["start_s"], node["stop_s"], node["rate_hz"], None if times is None else tuple(times)
    )


def _aim(node: dict[str, Any], path: str, streams: Streams) -> PointAim | ObjectAim:
    if node["type"] == "point":
        return PointAim(node["x_m"], node["y_m"], node["height_m"])
    u = streams.uniforms(f"{path}/center/object", 1)
    return ObjectAim(node["object"], node["id"], float(u[0]))


def _random(node: dict[str, Any], path: str, streams: Streams) -> RandomPose:
    look, limits = node["look"], node["limits"]
    numbers = {"height_m": node["height_m"], "roll_deg": node["roll_deg"]}
    places = {name: f"{path}/{name}" for name in numbers}
    for key in ("bearing_deg", "pitch_deg", "x_m", "y_m", "height_m"):
        if key in look:
            name = "target_height_m" if key == "height_m" else key
            numbers[name], places[name] = look[key], f"{path}/look/{key}"
    for name in ("place0", "place1", "object"):
        places[name] = f"{path}/{name}"
    return RandomPose(
        polygon=np.array(node["region_m"], np.float64),
        above_ground=node["above"] == "ground",
        look=Look(look["type"], look.get("object", ""), look.get("id")),
        numbers=numbers,
        keys={name: streams.key(place) for name, place in places.items()},
        limits=Limits(
            clearance_m=limits["clearance_m"],
            distance_m=(limits["min_distance_m"], limits["max_distance_m"]),
            elevation_deg=(limits["min_elevation_deg"], limits["max_elevation_deg"]),
            incidence_deg=(limits["min_incidence_deg"], limits["max_incidence_deg"]),
            max_sky=limits["max_sky"],
        ),
        tries=node["tries"],
    )
