"""Arrays that kernels look at without counting references."""

from __future__ import annotations

from typing import Any

from scenec.schemas.kernels import intrinsic


@intrinsic
def borrowed(context, value):  # type: ignore[no-untyped-def]
    """The same array, or named tuple of arrays, without owners.

    Only of what the calling function was given: its caller keeps that until it returns. An array
    made in the same function would be freed where it is last named, which is here.

    A function of numba counts up the owner of each array that it is given, and counts it down when
    it is done; it cannot leave that out around loops. Where a ray's walk hands all of a scene's
    arrays to small functions that was half of its time. What has no owner is not counted, once the
    small functions are part of the large one (``inlined``).
    """
    from numba.core import cgutils, types
    from numba.core.types.containers import NamedTuple, NamedUniTuple

    if not isinstance(value, types.Array | NamedTuple | NamedUniTuple):
        return None

    def without_owner(context: Any, builder: Any, kind: Any, given: Any) -> Any:
        if not isinstance(kind, types.Array):
            return given
        array = context.make_array(kind)(context, builder, given)
        array.meminfo = cgutils.get_null_value(array.meminfo.type)
        array.parent = cgutils.get_null_value(array.parent.type)
        return array._getvalue()

    def make(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        if isinstance(value, types.Array):
            return without_owner(context, builder, value, arguments[0])
        members = [
            without_owner(context, builder, kind, builder.extract_value(arguments[0], i))
            for i, kind in enumerate(value)
        ]
        return context.make_tuple(builder, signature.return_type, members)

    return value(value), make
