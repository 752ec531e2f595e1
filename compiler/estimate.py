"""Estimates what compiling a batch will take, from the cfg alone, and refuses what cannot fit.

Bytes and seconds are those of what grows without bound with a key: instances, height samples,
pictures of skies, triangles of prototypes and models, samples, classes. They were measured at the
peak of a compilation on two cores (``docs/numbers.md`` holds the table): memory within 35 %, time
within a factor of 3, which depends on the machine. What has a bound of its own is in
``BASE_BYTES``.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any, Final

from scenec.compiler.cfg.load import Spec
from scenec.compiler.distributions.laws import golombek_rapp_per_m2
from scenec.compiler.distributions.numbers import Distribution
from scenec.compiler.distributions.resolve import resolve
from scenec.compiler.distributions.streams import Streams
from scenec.compiler.terrain.grid import Grid
from scenec.schemas.errors import SceneError
from scenec.schemas.memory import GB, available

#: Of libraries, compiled kernels and what is bounded.
BASE_BYTES: Final = 340e6
#: Refused is what is estimated at more than this times the memory there is: estimates err.
MARGIN: Final = 1.25
#: Above this share of the memory there is, it is said.
TIGHT: Final = 0.8
#: Compilations that take longer than this are announced, seconds.
LONG_S: Final = 180.0
_INSTANCE: Final = (250.0, 2e-5)
_HEIGHT_SAMPLE: Final = (160.0, 1.2e-6)
#: Of each further layer of the ground, a height sample.
_LAYER: Final = (40.0, 0.5e-6)
#: Of each sample, in the sample's own memory.
_EROSION_STEP: Final = (0.0, 2.5e-7)
_TRIANGLE: Final = (45.0, 0.5e-6)
#: Of all pictures, and of the one that is being made.
_SKY_PIXEL: Final = (22.0, 1e-6)
_SKY_BAKE: Final = 45.0
#: With cumulus, and of cirrus alone (``docs/light.md``).
_CUMULUS_PIXEL: Final = (22.0, 4e-6)
_CIRRUS_PIXEL: Final = (22.0, 0.3e-6)
_PROTOTYPE_TRIANGLE: Final = (60.0, 3e-6)
#: Of files of meshes, with their levels of detail; of those with leaves, of which steps that run
#: beside each other hold several.
_MODEL_TRIANGLE: Final = (240.0, 3e-6)
_FOLIAGE_TRIANGLE: Final = (600.0, 6e-6)
_SAMPLE: Final = (1000.0, 3.5e-3)
_CLASS: Final = (150e3, 3e-2)
#: Numbers of the cfg that each take less are not named, share of all.
_NAMED: Final = 0.05


@dataclass(frozen=True)
class Need:
    """Estimates the memory and time that one key of a cfg takes.

    Attributes:
        pointer: The key: "objects/rocks/count".
        what: How many of what.
        bytes: At the peak of a batch.
        seconds: Of a batch.
    """

    pointer: str
    what: str
    bytes: float
    seconds: float


def needs_of(spec: Spec, seed: int, batch: int) -> list[Need]:
    """Estimates what compiling a batch takes, the largest first.

    Args:
        spec: A validated cfg.
        seed, batch: Of the batch: the numbers are those that it will draw.
    """
    streams = Streams(seed, batch)
    found = [*_terrain(spec, streams), *_objects(spec, streams), *_light(spec)]
    sensors = sum(len(rig["sensors"]) for rig in spec.cfg["rigs"].values())
    samples = int(spec.cfg["samples"])
    found.append(_need("samples", samples * max(sensors, 1), "poses of sensors", _SAMPLE))
    return sorted(found, key=lambda need: (-need.bytes, need.pointer))


def require_memory(needs: list[Need], free: int | None = None, workers: int = 1) -> str | None:
    """Refuses what does not fit into memory; returns a line where it will be tight.

    Args:
        needs: Of a batch.
        free: Bytes that are free; None: what this machine and its container have left.
        workers: How many batches are compiled at once, each with so much.

    Raises:
        SceneError: It does not fit.
    """
    free = available() if free is None else free
    most = BASE_BYTES + sum(need.bytes for need in needs)
    if most <= TIGHT * free:
        return None
    named = "; ".join(
        f"{need.pointer}: {need.what}, about {need.bytes / GB:.2g} GB"
        for need in needs
        if need.bytes >= _NAMED * most
    )
    each = f" to each of {workers} workers (--workers)" if workers > 1 else ""
    said = f"compiling needs about {most / GB:.2g} GB, {free / GB:.2g} GB are available{each}"
    if most <= MARGIN * free:
        return f"{said} ({named})" if named else said
    before = f"{named}: " if named else ""
    raise SceneError(f"{before}{said}: expected {'fewer, or ' if named else ''}more memory")


def time_warning(needs: list[Need], batches: int) -> str | None:
    """A line where compiling takes long, with what causes it; None where it does not."""
    seconds = sum(need.seconds for need in needs)
    if seconds * batches < LONG_S:
        return None
    named = "; ".join(
        f"{need.pointer}: {need.what}"
        for need in sorted(needs, key=lambda need: (-need.seconds, need.pointer))[:3]
        if need.seconds >= _NAMED * seconds
    )
    each = f" for {batches:,} batches" if batches > 1 else ""
    return f"compiling takes some {seconds * batches / 60.0:.2g} minutes{each}: {named}"


def _need(pointer: str, number: float, what: str, cost: tuple[float, float]) -> Need:
    return Need(pointer, f"{number:,.0f} {what}", number * cost[0], number * cost[1])


def _terrain(spec: Spec, streams: Streams) -> Iterator[Need]:
    terrain = spec.cfg["terrain"]
    node = resolve({key: terrain[key] for key in ("size_m", "spacing_m")}, streams, "terrain")
    shape = Grid.with_spacing((node["size_m"][0], node["size_m"][1]), node["spacing_m"]).shape
    samples = shape[0] * shape[1]
    yield _need("terrain/spacing_m", samples, "height samples", _HEIGHT_SAMPLE)
    for i, operator in enumerate(terrain["relief"]):
        if "steps" in operator:
            pointer = f"terrain/relief/{i}/steps"
            steps = samples * resolve(operator["steps"], streams, pointer)
            yield _need(pointer, steps, "steps of height samples", _EROSION_STEP)
    layers = samples * (len(terrain["ground"]) - 1)
    yield _need("terrain/ground", layers, "weights of layers", _LAYER)
    if terrain["mesh"]["tolerance_px"] == 0:
        triangles = min(2 * samples, terrain["mesh"]["max_triangles"])
        yield _need("terrain/mesh/tolerance_px", triangles, "triangles", _TRIANGLE)


def _objects(spec: Spec, streams: Streams) -> Iterator[Need]:
    size = resolve(spec.cfg["terrain"]["size_m"], streams, "terrain/size_m")
    classes = 0
    for name, cfg in spec.cfg["objects"].items():
        classes += 1
        path = f"objects/{name}"
        if cfg["type"] == "rocks":
            node = resolve({k: cfg[k] for k in ("prototypes", "subdivisions")}, streams, path)
            triangles = int(node["prototypes"]) * 20 * 4 ** int(node["subdivisions"])
            yield _need(
                f"{path}/subdivisions", triangles, "prototype triangles", _PROTOTYPE_TRIANGLE
            )
        if cfg["type"] == "meshes":
            for i, model in enumerate(cfg["models"]):
                yield _model(spec, f"{path}/models/{i}", model)
        if "count" not in cfg:
            continue
        key = "count" if cfg["count"] is not None else "per_m2"
        number = resolve(cfg[key], streams, f"{path}/{key}")
        if key == "per_m2":
            if number is None:
                key, law = "size_m", cfg["size_m"]
                assert isinstance(law, Distribution)
                number = golombek_rapp_per_m2(law.min, law.max, law.shape)
            beyond = resolve(cfg["beyond_m"], streams, f"{path}/beyond_m") or 0.0
            number *= (size[0] + 2.0 * beyond) * (size[1] + 2.0 * beyond)
        yield _need(f"{path}/{key}", number, "instances", _INSTANCE)
    if classes:
        yield _need("objects", classes, "classes", _CLASS)


def _model(spec: Spec, path: str, model: dict[str, Any]) -> Need:
    """The need of a model, whose file was read when the cfg was checked, and is kept."""
    from scenec.compiler.assets.model import cached_model, origin_of

    file, origin = spec.files[f"{path}/file"].path, origin_of(model["origin"])
    read = cached_model(file, model["unit_m"], model["up"], model["part"], origin)
    leaves = any(material.diffuse_transmission > 0.0 for material in read.materials)
    cost = _FOLIAGE_TRIANGLE if leaves else _MODEL_TRIANGLE
    return _need(f"{path}/file", len(read.faces), "triangles of a model", cost)


def _light(spec: Spec) -> Iterator[Need]:
    light = spec.cfg["light"]
    sky = light["sky"] or {}
    if "resolution" not in sky:
        return
    parts = [("sky", sky, [sky, light["sun"]], "pixels of skies", _SKY_PIXEL, 1.0)]
    clouds = light.get("clouds")
    if clouds is not None:
        drawn = [sky, light["sun"], clouds]
        cost = _CIRRUS_PIXEL if clouds["cumulus"] is None else _CUMULUS_PIXEL
        parts.append(("clouds", clouds, drawn, "pixels of skies with clouds", cost, 2.0))
    for name, node, drawn, what, cost, being_made in parts:
        pictures = int(spec.cfg["samples"]) if any(map(_per_sample, drawn)) else 1
        pixels = 2 * node["resolution"] * node["resolution"]
        all_ = _need(f"light/{name}/resolution", pictures * pixels, what, cost)
        yield replace(all_, bytes=all_.bytes + being_made * _SKY_BAKE * pixels)


def _per_sample(node: Any) -> bool:
    """Whether any number of a part of a cfg is drawn for each sample."""
    if isinstance(node, Distribution):
        return node.per == "sample"
    if isinstance(node, dict):
        return any(map(_per_sample, node.values()))
    return isinstance(node, list) and any(map(_per_sample, node))
