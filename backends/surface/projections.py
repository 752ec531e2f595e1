"""Projects maps onto a surface, and tilts normals by maps of normals.

Triplanar normals: Golus 2017, Normal Mapping for a Triplanar Shader, the whiteout blend, summed
over the three planes by the weights of the colors. On a plane its tangent part is added to the
shading normal's, its z scales the rest; a flat map leaves the shading normal as it is, and bumps
stay bumps on both sides of the planes, on whose far side the picture is seen mirrored.
"""

from __future__ import annotations

from collections.abc import Sequence

from scenec.backends.surface.algebra import Algebra, Number, Vector

#: World axes that are u and v on the planes across x, y and z.
PLANES = ((1, 2), (0, 2), (0, 1))
#: Cosine at which viewers stand whom the shading normal leans away from.
GRAZING = 1e-5


def plane_shares(fn: Algebra, normal: Vector) -> tuple[Number, Number, Number]:
    """Share of the planes across x, y and z for a unit shading normal.

    n**4 of each component, over their sum: equal on a vector and its opposite, and smooth.
    """
    squares = normal * normal
    x, y, z = fn.parts(squares * squares)
    total = 1.0 / (x + y + z)
    return x * total, y * total, z * total


def from_sides(
    fn: Algebra, normal: Vector, shares: Sequence[Number], mapped: Sequence[Vector]
) -> Vector:
    """The leaned normal of a map seen along the world's axes.

    Args:
        fn: The algebra.
        normal: The unit shading normal, where it points outward.
        shares: From ``plane_shares``.
        mapped: What the map holds on each plane.
    """
    total = None
    for axis, (share, on_plane, (u, v)) in enumerate(zip(shares, mapped, PLANES, strict=True)):
        more, scale = [0.0, 0.0, 0.0], [1.0, 1.0, 1.0]
        more[u], more[v], scale[axis] = fn.parts(on_plane)
        part = (normal * fn.vector(*scale) + fn.vector(*more)) * share
        total = part if total is None else total + part
    return fn.unit(total)


def along_x(fn: Algebra, flat: Vector) -> Vector:
    """Along a face of unit normal ``flat``, over the world's x: dP/du of maps from above."""
    x, _, z = fn.parts(flat)
    return fn.vector(fn.absolute(z), 0.0, -fn.sign(z) * x)


def leaned(
    fn: Algebra, mapped: Vector, normal: Vector, along_u: Vector, along_v: Vector | None
) -> Vector:
    """The leaned normal of a map that lies along a surface, a unit vector.

    The tangent is dP/du less its part along the shading normal; the bitangent is across both, on
    the side of dP/dv. Unlike MikkTSpace's, they are not averaged over a vertex's triangles: the
    two agree where coordinates are smooth in space. Where a triangle has no area in the picture,
    normals stay as they are.

    Args:
        fn: The algebra.
        mapped: What the map holds.
        normal: The unit shading normal, where it points outward.
        along_u, along_v: dP/du and dP/dv, of any length; None: on the bitangent's side.
    """
    x, y, z = fn.parts(mapped)
    tangent = fn.unit(along_u - normal * fn.dot(normal, along_u))
    across = fn.cross(normal, tangent)
    if along_v is not None:
        y = y * fn.sign(fn.dot(across, along_v))
    return fn.unit(tangent * x + across * y + normal * z)


def towards(fn: Algebra, tangent: Vector, height: Number, facing: Vector, view: Vector) -> Vector:
    """A leaned normal on the side that is seen, a unit vector.

    What points away from the viewer has its tangential part turned round. Where the shading normal
    itself leans away, the viewer counts as at its horizon.

    Args:
        fn: The algebra.
        tangent, height: The leaned normal's parts across and along the shading normal.
        facing: The shading normal, on the side of its face that is seen.
        view: Unit vector to the viewer.
    """
    above = fn.maximum(fn.dot(facing, view), GRAZING)
    seen = fn.dot(tangent, view) + height * above
    return fn.unit(tangent * fn.select(seen, 1.0, -1.0) + facing * height)


def sided(fn: Algebra, leaned: Vector, normal: Vector, facing: Vector) -> Vector:
    """A leaned normal mirrored to the side that is seen, wherever it points there.

    Args:
        fn: The algebra.
        leaned: The normal; ``normal`` points outward.
        normal: The shading normal.
        facing: The same, or its opposite: on the side of its face that is seen.
    """
    return leaned + (facing - normal) * fn.dot(leaned, normal)


def seen(fn: Algebra, leaned: Vector, normal: Vector, facing: Vector, view: Vector) -> Vector:
    """``towards`` of a leaned normal that is not split: ``normal`` points outward."""
    height = fn.dot(leaned, normal)
    return towards(fn, leaned - normal * height, height, facing, view)
