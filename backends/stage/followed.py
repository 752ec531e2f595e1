"""Lists attributes of schemas that the reader follows, by type, and those without effect.

Whatever else is authored, and is not as it is without that, is named (``unread``). A test changes
each attribute that is said to be followed and demands another RenderScene.
"""

from __future__ import annotations

from scenec.backends.stage.implicit import LENGTHS

_LIGHT = frozenset(
    (
        *("inputs:color", "inputs:enableColorTemperature", "inputs:colorTemperature"),
        *("inputs:intensity", "inputs:exposure", "visibility", "xformOpOrder"),
    )
)
_PRODUCT = frozenset(
    ("resolution", "aspectRatioConformPolicy", "pixelAspectRatio", "dataWindowNDC")
)
_SHAPE = frozenset(("visibility", "purpose", "xformOpOrder", "primvars:displayColor"))

#: By type of prim.
FOLLOWED: dict[str, frozenset[str]] = {
    "Camera": frozenset(
        (
            *("projection", "focalLength", "horizontalAperture", "verticalAperture"),
            *("horizontalApertureOffset", "verticalApertureOffset", "focusDistance", "fStop"),
            *("exposure", "exposure:time", "exposure:iso", "exposure:fStop"),
            *("exposure:responsivity", "xformOpOrder"),
        )
    ),
    "RenderProduct": _PRODUCT,
    "RenderSettings": _PRODUCT,
    "RenderVar": frozenset(("sourceName",)),
    "DistantLight": _LIGHT | {"inputs:angle", "inputs:normalize"},
    "DomeLight": _LIGHT | {"inputs:texture:file"},
    "DomeLight_1": _LIGHT | {"inputs:texture:file", "poleAxis"},
    "SphereLight": _LIGHT
    | {"inputs:normalize", "inputs:radius", "treatAsPoint"}
    | {"inputs:shaping:cone:angle", "inputs:shaping:cone:softness"},
    "Mesh": _SHAPE
    | {"points", "faceVertexCounts", "faceVertexIndices", "holeIndices", "normals", "orientation"}
    | {"subdivisionScheme", "cornerIndices", "cornerSharpnesses", "creaseIndices", "creaseLengths"}
    | {"creaseSharpnesses", "interpolateBoundary", "faceVaryingLinearInterpolation"}
    | {"triangleSubdivisionRule"},
    "BasisCurves": _SHAPE | {"points", "curveVertexCounts", "widths", "type", "basis", "wrap"},
    "GeomSubset": frozenset(("indices", "elementType", "familyName")),
    "PointInstancer": frozenset(
        (
            *("protoIndices", "ids", "positions", "orientations", "orientationsf", "scales"),
            *("invisibleIds", "visibility", "purpose", "xformOpOrder"),
        )
    ),
    **{
        kind: _SHAPE | set(lengths) | ({"axis"} if kind not in ("Cube", "Sphere") else set())
        for kind, lengths in LENGTHS.items()
    },
}

#: Of no effect, whatever the type: a box to cull by.
_EVERYWHERE = frozenset(("extent",))
_UNSHADED = frozenset(("visibility", "purpose"))
_OF_NO_EFFECT_ON_LIGHTS = frozenset(("purpose", "guideRadius", "light:materialSyncMode"))
#: Faces are seen from both sides whatever is said.
_SIDES = frozenset(("doubleSided",))
#: By type of prim. A clipping range hides nothing: the contract knows no clipping planes. The
#: opacity of ``displayColor`` has a line of its own; so have purposes and render variables of
#: others.
WITHOUT_EFFECT: dict[str, frozenset[str]] = {
    "Camera": _UNSHADED | {"clippingRange", "stereoRole"},
    "RenderProduct": frozenset(("productName",)),
    "RenderVar": frozenset(("dataType", "sourceType")),
    "DistantLight": _OF_NO_EFFECT_ON_LIGHTS,
    "DomeLight": _OF_NO_EFFECT_ON_LIGHTS | {"inputs:normalize"},
    "DomeLight_1": _OF_NO_EFFECT_ON_LIGHTS | {"inputs:normalize"},
    "SphereLight": _OF_NO_EFFECT_ON_LIGHTS,
    # A picture that a light shines through: ours, at its place.
    "LightFilter": _UNSHADED | {"xformOpOrder"},
    "Mesh": _SIDES | {"velocities", "accelerations", "primvars:displayOpacity"},
    # Normals of curves have a line of their own.
    "BasisCurves": _SIDES
    | {"orientation", "velocities", "accelerations", "normals", "primvars:displayOpacity"},
    "PointInstancer": frozenset(("velocities", "accelerations", "angularVelocities")),
    **{kind: _SIDES | {"orientation", "primvars:displayOpacity"} for kind in LENGTHS},
}

#: Values of the same effect as what holds without them.
NEUTRAL = (
    # A cone of so wide a half angle cuts nothing off.
    ("inputs:shaping:cone:angle", 180.0),
    ("inputs:texture:format", "latlong"),
    ("renderingColorSpace", "lin_rec709"),
    ("renderingColorSpace", "lin_rec709_scene"),
)

#: Inputs of UsdPreviewSurface, as above.
SURFACE = frozenset(
    (
        *("diffuseColor", "roughness", "metallic", "emissiveColor", "ior", "specularColor"),
        *("useSpecularWorkflow",),
    )
)


def is_followed(kind: str, name: str) -> bool:
    """Tells whether an attribute of a type of prim is followed, or of no effect.

    Args:
        kind: Of the prim.
        name: Of the attribute.
    """
    nothing: frozenset[str] = frozenset()
    return (
        name in FOLLOWED.get(kind, nothing)
        or name in WITHOUT_EFFECT.get(kind, nothing)
        or name in _EVERYWHERE
    )
