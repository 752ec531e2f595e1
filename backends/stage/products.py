"""Reads a stage's RenderProducts, and the RenderSettings that they inherit from.

A product that does not author a value has that of the settings that list it, as
``UsdRenderComputeSpec`` has it (pxr/usd/usdRender/spec.cpp, of which Python has no binding).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

from pxr import Sdf, Usd, UsdGeom, UsdRender

from scenec.backends.stage import values
from scenec.backends.stage.scene import DEFAULT_OUTPUTS
from scenec.schemas.errors import StageError
from scenec.schemas.passes import is_pass

_FIRST = Usd.TimeCode.EarliestTime()
_TOKENS = UsdRender.Tokens
POLICIES = (
    _TOKENS.expandAperture,
    _TOKENS.cropAperture,
    _TOKENS.adjustApertureWidth,
    _TOKENS.adjustApertureHeight,
    _TOKENS.adjustPixelAspectRatio,
)
#: Of pictures of a camera that no product names, and their size where its aperture says none.
_WIDTH, _HEIGHT = 640, 480
#: Pixels of a data window: beyond, arrays would not fit.
_MOST_PIXELS = 2**31


@dataclass(frozen=True)
class Request:
    """Describes a requested picture of a camera.

    Attributes:
        name: Of the camera in file paths.
        prim: The camera.
        full: Width and height of the picture that its whole aperture would make, pixels.
        window: First column, first row, width and height of the part that is rendered; may reach
            beyond the whole.
        outputs: Passes.
        policy: How apertures are made to fit, one of ``POLICIES``.
        pixel_aspect: Width of a pixel over its height.
    """

    name: str
    prim: Usd.Prim
    full: tuple[int, int]
    window: tuple[int, int, int, int]
    outputs: tuple[str, ...] = DEFAULT_OUTPUTS
    policy: str = POLICIES[0]
    pixel_aspect: float = 1.0


def read_requests(stage: Usd.Stage) -> tuple[list[Request], list[Usd.Prim]]:
    """Lists the pictures to render.

    Without a product it is the camera of the stage's settings; without one there, every camera that
    is not orthographic, unless all are; 640 pixels wide.

    Returns:
        The pictures, and the orthographic cameras that were left out.

    Raises:
        StageError: A product without a camera, or a value that cannot be.
    """
    asking = [p for p in stage.Traverse() if p.IsA(UsdRender.SettingsBase)]
    products = [p for p in asking if p.IsA(UsdRender.Product)]
    if products:
        settings = settings_of_products(stage)
        return [
            _of_product(name, p, settings.get(p.GetPath())) for name, p in _distinct_names(products)
        ], []
    chosen = UsdRender.Settings.GetStageRenderSettings(stage).GetPrim()
    if not chosen:
        # Without a word of the stage, the only ones.
        chosen = asking[0] if len(asking) == 1 else None
    targets = values.targets(chosen, "camera") if chosen else []
    if chosen and targets:
        camera = _camera_at(stage, targets[0], chosen)
        return [_of_settings(camera.GetName(), camera, chosen)], []
    cameras = list(_cameras(stage))
    flat = [p for p in cameras if _is_orthographic(p)]
    if len(flat) == len(cameras):
        flat = []
    drawn = [p for p in cameras if p not in flat]
    return [_of_settings(name, p, chosen) for name, p in _distinct_names(drawn)], flat


def settings_of_products(stage: Usd.Stage) -> dict[Sdf.Path, Usd.Prim]:
    """Returns the RenderSettings whose values each product inherits, by the product's path.

    Where several list a product it is the stage's own settings, else the first.
    """
    every = [p for p in stage.Traverse() if p.IsA(UsdRender.Settings)]
    first = UsdRender.Settings.GetStageRenderSettings(stage).GetPrim()
    every.sort(key=lambda prim: prim != first)
    products: dict[Sdf.Path, Usd.Prim] = {}
    for prim in every:
        for target in values.targets(prim, "products"):
            products.setdefault(target, prim)
    return products


def _is_orthographic(prim: Usd.Prim) -> bool:
    """Tells whether a camera is orthographic, at the first time where that changes."""
    attribute = UsdGeom.Camera(prim).GetProjectionAttr()
    kind = values.word(attribute, UsdGeom.Tokens.perspective, _FIRST)
    return kind == UsdGeom.Tokens.orthographic


def conformed(
    across: float, up: float, full: tuple[int, int], policy: str, pixel_aspect: float
) -> tuple[float, float]:
    """Fits apertures to a picture, as ``_ApplyAspectRatioPolicy`` of usdRender/spec.cpp does.

    Args:
        across, up: Apertures, above 0.
        full: Width and height of the picture, pixels.
        policy: One of ``POLICIES``.
        pixel_aspect: Width of a pixel over its height.
    """
    image = pixel_aspect * full[0] / full[1]
    wide = across / up > image
    if policy == _TOKENS.adjustPixelAspectRatio:
        return across, up
    if policy == _TOKENS.adjustApertureHeight or (
        wide if policy == _TOKENS.expandAperture else not wide and policy == _TOKENS.cropAperture
    ):
        return across, across / image
    return up * image, up


def _cameras(stage: Usd.Stage) -> Iterator[Usd.Prim]:
    prims = iter(Usd.PrimRange(stage.GetPseudoRoot(), Usd.TraverseInstanceProxies()))
    for prim in prims:
        if prim.IsA(UsdGeom.PointInstancer):
            # What is below it is there only as its instances.
            prims.PruneChildren()
        if prim.IsA(UsdGeom.Camera):
            yield prim


def _of_product(name: str, prim: Usd.Prim, settings: Usd.Prim | None) -> Request:
    stage = prim.GetStage()
    targets = values.targets(prim, "camera")
    if not targets and settings:
        targets = values.targets(settings, "camera")
    if not targets:
        raise StageError(f"{prim.GetPath()}: this RenderProduct names no camera")
    camera = _camera_at(stage, targets[0], prim)
    outputs: dict[str, None] = {}
    for target in values.targets(prim, "orderedVars"):
        var = UsdRender.Var(stage.GetPrimAtPath(target))
        source = values.word(var.GetSourceNameAttr(), "") if var else ""
        # Foreign products name their renderer's own variables: those are not ours to make.
        if is_pass(source.split(".")[0]):
            outputs[source.split(".")[0]] = None
    size = values.vector(_authored("resolution", prim, settings), 2) or (_WIDTH, _HEIGHT)
    full = (int(size[0]), int(size[1]))
    return _request(name, camera, full, (prim, settings), tuple(outputs))


def _of_settings(name: str, camera: Usd.Prim, settings: Usd.Prim | None) -> Request:
    """Makes a request for a camera without a product."""
    resolution = settings.GetAttribute("resolution") if settings else None
    if resolution and resolution.HasAuthoredValue():
        width, height = values.vector(resolution, 2) or (_WIDTH, _HEIGHT)
        full = (int(width), int(height))
    else:
        lens = UsdGeom.Camera(camera)
        across = values.number(lens.GetHorizontalApertureAttr(), 0.0, _FIRST)
        up = values.number(lens.GetVerticalApertureAttr(), 0.0, _FIRST)
        full = (_WIDTH, max(1, round(_WIDTH * up / across)) if across > 0 else _HEIGHT)
    return _request(name, camera, full, (settings,), ())


def _request(
    name: str,
    camera: Usd.Prim,
    full: tuple[int, int],
    prims: tuple[Usd.Prim | None, ...],
    outputs: tuple[str, ...],
) -> Request:
    if min(full) < 1:
        raise StageError(
            f"{(prims[0] or camera).GetPath()}: a camera needs a resolution, at least 1 x 1; it is "
            f"{full[0]} x {full[1]}"
        )
    policy, aspect, window = (
        _authored(name, *prims)
        for name in ("aspectRatioConformPolicy", "pixelAspectRatio", "dataWindowNDC")
    )
    ratio = values.number(aspect, 1.0)
    if not 0.0 < ratio < math.inf:
        where = aspect.GetPath() if aspect else name
        raise StageError(f"{where}: is {ratio:g}, expected a number above 0")
    return Request(
        name,
        camera,
        full,
        _window(full, window),
        outputs or DEFAULT_OUTPUTS,
        values.word(policy, POLICIES[0], known=POLICIES),
        ratio,
    )


def _window(full: tuple[int, int], attribute: Usd.Attribute | None) -> tuple[int, int, int, int]:
    """Returns the pixels whose centers a data window holds, left and lower borders included.

    Raises:
        StageError: It holds none.
    """
    width, height = full
    stated = values.vector(attribute, 4) if attribute else None
    left, bottom, right, top = stated or (0.0, 0.0, 1.0, 1.0)
    # Of pixel k the center is at (k + 0.5) / width.
    columns = [math.ceil(x * width - 0.5) for x in (left, right)]
    # Rows go down, the window's y goes up.
    rows = [height - math.ceil(y * height - 0.5) for y in (top, bottom)]
    size = (columns[1] - columns[0], rows[1] - rows[0])
    if min(size) < 1 or math.prod(size) > _MOST_PIXELS:
        raise StageError(
            f"{attribute.GetPath() if attribute else ''}: is ({left:g}, {bottom:g}, {right:g}, "
            f"{top:g}), {size[0]} x {size[1]} pixels; expected at least one, and at most 2**31"
        )
    return columns[0], rows[0], *size


def _authored(name: str, *prims: Usd.Prim | None) -> Usd.Attribute | None:
    """Returns an attribute of the first prim that authors it, else of the first that has it."""
    found = [prim.GetAttribute(name) for prim in prims if prim]
    return next((each for each in found if each.HasAuthoredValue()), next(iter(found), None))


def _camera_at(stage: Usd.Stage, path: Sdf.Path, of: Usd.Prim) -> Usd.Prim:
    camera = stage.GetPrimAtPath(path)
    if not camera or not camera.IsA(UsdGeom.Camera):
        raise StageError(f"{of.GetPath()}: this {of.GetTypeName()} names no camera")
    return camera


def _distinct_names(prims: list[Usd.Prim]) -> list[tuple[str, Usd.Prim]]:
    taken = [p.GetName() for p in prims]
    return [
        (
            p.GetName()
            if taken.count(p.GetName()) == 1
            else str(p.GetPath())[1:].replace("/", "_"),
            p,
        )
        for p in prims
    ]
