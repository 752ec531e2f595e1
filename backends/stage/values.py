"""Values of attributes, checked: what a reader gets is of the type and the shape that it expects.

USD hands out whatever was authored: a string where a schema has points, NaN, two numbers for three.
All of these end here, in an error that names prim and attribute, what it is and what was expected.
An attribute that is not there, or has no value, is no error: the reader's default stands for it.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Collection, Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray
from pxr import Gf, Sdf, Tf, Usd, UsdGeom, Vt

from scenec.schemas.errors import StageError
from scenec.schemas.native import commentary
from scenec.schemas.spelling import nearest, shown

DEFAULT = Usd.TimeCode.Default()
#: How far the last column of a transform may be from an affine one's: inverses that USD computes.
_PROJECTIVE = 1e-9
_AFFINE = np.array([0.0, 0.0, 0.0, 1.0])
#: Longest value that a message quotes.
_QUOTED = 40


def value_of(attribute: Usd.Attribute, time: Usd.TimeCode = DEFAULT) -> Any:
    """Returns an attribute's value, of any type; None where it is absent or has no value.

    Raises:
        StageError: USD cannot read it.
    """
    if not attribute:
        return None
    try:
        return attribute.Get(time)
    except Tf.ErrorException as error:
        raise StageError(f"{attribute.GetPath()}: cannot be read: {said(error)}") from error


def number(
    attribute: Usd.Attribute,
    default: float,
    time: Usd.TimeCode = DEFAULT,
    *,
    finite: bool = True,
) -> float:
    """A number.

    Raises:
        StageError: It is none, or not finite where it has to be.
    """
    expected = "a finite number" if finite else "a number"
    value = _typed(attribute, time, int | float, expected)
    if value is None:
        return default
    found = float(value)
    if math.isnan(found) or (finite and math.isinf(found)):
        raise StageError(f"{attribute.GetPath()}: is {found:g}, expected {expected}")
    return found


def whole(attribute: Usd.Attribute, default: int, time: Usd.TimeCode = DEFAULT) -> int:
    """A whole number.

    Raises:
        StageError: It is none.
    """
    value = _typed(attribute, time, int, "a whole number")
    return default if value is None else int(value)


def flag(attribute: Usd.Attribute, default: bool, time: Usd.TimeCode = DEFAULT) -> bool:
    """True or false.

    Raises:
        StageError: Neither.
    """
    value = _typed(attribute, time, bool, "a bool")
    return default if value is None else bool(value)


def word(
    attribute: Usd.Attribute,
    default: str,
    time: Usd.TimeCode = DEFAULT,
    known: Collection[str] = (),
) -> str:
    """A token or a string; the default where it is empty.

    Raises:
        StageError: It is none, or none of those known.
    """
    value = _typed(attribute, time, str, "a token")
    if not value:
        return default
    if known and value not in known:
        raise StageError(f"{attribute.GetPath()}: is {shown(value)}{nearest(value, known)}")
    return str(value)


def words(attribute: Usd.Attribute, time: Usd.TimeCode = DEFAULT) -> list[str]:
    """Tokens or strings.

    Raises:
        StageError: They are none.
    """
    value = _typed(attribute, time, Vt.TokenArray | Vt.StringArray, "an array of tokens")
    return [str(each) for each in value or ()]


def _typed(attribute: Usd.Attribute, time: Usd.TimeCode, kind: Any, expected: str) -> Any:
    """A value of some type, where a bool is no number; None where there is none."""
    value = value_of(attribute, time)
    if value is None or (isinstance(value, kind) and (kind is bool or not isinstance(value, bool))):
        return value
    raise _mistyped(attribute, value, expected)


def vector(
    attribute: Usd.Attribute,
    count: int,
    time: Usd.TimeCode = DEFAULT,
    *,
    finite: bool = True,
    of_more: bool = False,
) -> tuple[float, ...] | None:
    """So many numbers, of a vector or an array; None where there is no value.

    Args:
        attribute: The attribute.
        count: How many.
        time: When.
        finite: Whether infinity is refused; NaN always is.
        of_more: Whether they may be the first of more.

    Raises:
        StageError: They are none, or more or fewer, or not finite where they have to be.
    """
    value = value_of(attribute, time)
    if value is None:
        return None
    expected = f"{count} {'finite ' if finite else ''}numbers"
    found = _numeric(value)
    if found is None or found.ndim != 1:
        raise _mistyped(attribute, value, expected)
    if len(found) != count and not (of_more and len(found) > count):
        raise StageError(f"{attribute.GetPath()}: holds {len(found)} numbers, expected {count}")
    numbers = found[:count].astype(np.float64)
    if np.isnan(numbers).any() or (finite and np.isinf(numbers).any()):
        raise StageError(f"{attribute.GetPath()}: is {_quoted(value)}, expected {expected}")
    return tuple(numbers.tolist())


def array(
    attribute: Usd.Attribute,
    dtype: DTypeLike,
    time: Usd.TimeCode = DEFAULT,
    *,
    width: tuple[int, ...] = (),
    finite: bool = True,
) -> NDArray[Any]:
    """An array attribute as an array of its own, dtype [n, *width]; empty without a value.

    Args:
        attribute: The attribute.
        dtype: What its values have to fit in: whole numbers where it is one of these.
        time: When.
        width: Shape of one value; () of plain numbers.
        finite: Whether NaN and infinity are refused.

    Raises:
        StageError: It is none, of another width, or holds what does not fit.
    """
    return as_array(attribute, value_of(attribute, time), dtype, width=width, finite=finite)


def as_array(
    attribute: Usd.Attribute,
    value: Any,
    dtype: DTypeLike,
    *,
    width: tuple[int, ...] = (),
    finite: bool = True,
) -> NDArray[Any]:
    """Converts a value made from the attribute's, as ``array`` does."""
    kind = np.dtype(dtype)
    if value is None:
        return np.zeros((0, *width), kind)
    what = "whole numbers" if kind.kind in "iu" else "numbers"
    each = what if not width else f"{' x '.join(map(str, width))} {what} each"
    found = _numeric(value)
    if (
        found is None
        or found.ndim != 1 + len(width)
        or (kind.kind in "iu" and found.dtype.kind == "f")
    ):
        raise _mistyped(attribute, value, f"an array of {each}")
    if found.shape[1:] != width:
        # Of an empty one nobody knows.
        if not found.size:
            return np.zeros((0, *width), kind)
        raise _mistyped(attribute, value, f"an array of {each}")
    if kind.kind in "iu" and found.size and found.dtype != kind:
        low, high = int(found.min()), int(found.max())
        if low < np.iinfo(kind).min or high > np.iinfo(kind).max:
            wrong = low if low < np.iinfo(kind).min else high
            raise StageError(f"{attribute.GetPath()}: holds {wrong}, which does not fit in {kind}")
    with np.errstate(over="ignore"):
        # What is too large becomes infinite, and is refused as that.
        made = np.array(found, kind)
    if finite and kind.kind == "f" and not np.isfinite(made).all():
        raise StageError(f"{attribute.GetPath()}: holds NaN or infinity")
    return made


def flattened(
    primvar: UsdGeom.Primvar, dtype: DTypeLike, time: Usd.TimeCode, *, width: tuple[int, ...] = ()
) -> NDArray[Any]:
    """A primvar's values behind its indices, [n, *width]; one value is an array of one.

    NaN and infinity pass: what they mean is the reader's to say.

    Raises:
        StageError: They are none, of another width, or its indices reach beyond them.
    """
    attribute = primvar.GetAttr()
    value = value_of(attribute, time)
    if value is not None and not _is_array(value):
        found = _numeric(value)
        if found is None or found.shape != width:
            raise _mistyped(attribute, value, "numbers")
        value = found[None]
    values = as_array(attribute, value, dtype, width=width, finite=False)
    if not primvar.IsIndexed():
        return values
    indices = array(primvar.GetIndicesAttr(), np.int64, time)
    if indices.size and not 0 <= indices.min() <= indices.max() < len(values):
        raise StageError(
            f"{primvar.GetIndicesAttr().GetPath()}: holds indices from {indices.min()} to "
            f"{indices.max()}, of {len(values)} values"
        )
    return values[indices]


def targets(prim: Usd.Prim, name: str) -> list[Sdf.Path]:
    """Paths that a relationship leads to; none where there is none.

    Raises:
        StageError: It is an attribute, or goes in circles.
    """
    relationship = prim.GetRelationship(name)
    if not relationship:
        if prim.HasAttribute(name):
            raise StageError(f"{prim.GetPath()}.{name}: is an attribute, expected a relationship")
        return []
    try:
        return list(relationship.GetForwardedTargets())
    except Tf.ErrorException as error:
        raise StageError(f"{relationship.GetPath()}: cannot be read: {said(error)}") from error


def asset(attribute: Usd.Attribute, time: Usd.TimeCode = DEFAULT) -> Sdf.AssetPath | None:
    """The path of a file; None where it is empty.

    Raises:
        StageError: It is no asset.
    """
    value = _typed(attribute, time, Sdf.AssetPath, "an asset")
    return value if value is not None and value.path else None


def inputs(prim: Usd.Prim, *others: str) -> list[Usd.Attribute]:
    """Attributes of a prim that say neither where nor whether it is, nor begin with ``others``."""
    excluded = ("visibility", "xformOp", *others)
    return [a for a in prim.GetAttributes() if not a.GetName().startswith(excluded)]


def cached[T](
    attributes: Iterable[Usd.Attribute], read: Callable[[Usd.TimeCode], T]
) -> Callable[[Usd.TimeCode], T]:
    """Returns a reader at times that reads only once where none of its attributes varies."""
    if any(attribute and attribute.ValueMightBeTimeVarying() for attribute in attributes):
        return read
    cached: list[T] = []

    def first(time: Usd.TimeCode) -> T:
        if not cached:
            cached.append(read(time))
        return cached[0]

    return first


def visible(prim: Usd.Prim, times: Sequence[Usd.TimeCode]) -> NDArray[np.bool_]:
    """At which times a prim is not itself invisible, bool [times], or [1] where that never changes.

    Raises:
        StageError: Its visibility is no token.
    """
    attribute = UsdGeom.Imageable(prim).GetVisibilityAttr()
    some = times if attribute.ValueMightBeTimeVarying() else times[:1]
    return np.array([word(attribute, "", t) != UsdGeom.Tokens.invisible for t in some])


def matrices(
    prim: Usd.Prim, times: Sequence[Usd.TimeCode], *, of_world: bool = False
) -> NDArray[np.float64]:
    """Returns a prim's transforms in its parent: affine columns in stage units.

    Args:
        prim: The prim.
        times: When.
        of_world: Whether in the world instead.

    Returns:
        float64 [times, 3, 4]; in the parent [3, 4] where it does not move.

    Raises:
        StageError: An operation of it, or of a prim above it that counts, is no transform, is
            projective, or holds NaN or infinity.
    """
    above, moves = prim, False
    while above and not above.IsPseudoRoot():
        if xformable := UsdGeom.Xformable(above):
            # USD takes a prim for one without a transform where this is of another type.
            words(xformable.GetXformOpOrderAttr())
            moves |= xformable.TransformMightBeTimeVarying()
        above = above.GetParent() if of_world else None
    some = times if moves else times[:1]
    try:
        if of_world:
            found = _world_transforms(prim, some)
        else:
            own_ops = UsdGeom.Xformable(prim)
            found = [own_ops.GetLocalTransformation(time) for time in some]
    except Tf.ErrorException as error:
        raise StageError(
            f"{prim.GetPath()}: its transform cannot be read: {said(error)}"
        ) from error
    whole = np.array(Vt.Matrix4dArray(found)).transpose(0, 2, 1)
    affine = whole[:, :3].copy()
    if not np.isfinite(whole).all():
        raise StageError(f"{prim.GetPath()}: its transform holds NaN or infinity")
    last = whole[:, 3]
    if (last != _AFFINE).any() and (np.abs(last - _AFFINE) > _PROJECTIVE).any():
        worst = last[np.argmax(np.abs(last - _AFFINE).max(axis=1))]
        raise StageError(
            f"{prim.GetPath()}: its transform{' in the world' if of_world else ''} is projective: "
            f"the last column is ({', '.join(f'{value:g}' for value in worst)}), expected "
            "(0, 0, 0, 1)"
        )
    if of_world:
        return affine if moves else np.repeat(affine, len(times), axis=0)
    return affine if moves and (affine != affine[0]).any() else affine[0]


def _world_transforms(prim: Usd.Prim, times: Sequence[Usd.TimeCode]) -> list[Gf.Matrix4d]:
    cache, found = UsdGeom.XformCache(), []
    for time in times:
        cache.SetTime(time)
        found.append(cache.GetLocalToWorldTransform(prim))
    return found


def said(error: Tf.ErrorException) -> str:
    """Returns USD's message in one line, of its lines the first that names a place in a file."""
    lines = [" ".join(commentary(each).split()) for each in error.args]
    located = [line for line in lines if re.search(r":\d+:\d+: ", line)]
    return next((line for line in (*located, *lines) if line), "USD gives no reason")


def _is_array(value: Any) -> bool:
    return type(value).__module__.endswith("Vt") and type(value).__name__.endswith("Array")


def _numeric(value: Any) -> NDArray[Any] | None:
    """A value's numbers; None where it holds none."""
    try:
        found = np.asarray(value)
    except (TypeError, ValueError):
        return None
    return found if found.dtype.kind in "iuf" else None


def _mistyped(attribute: Usd.Attribute, value: Any, expected: str) -> StageError:
    kind = str(Sdf.GetValueTypeNameForValue(value)) or type(value).__name__
    return StageError(f"{attribute.GetPath()}: is of type {kind}, expected {expected}")


def _quoted(value: Any) -> str:
    text = str(value)
    return text if len(text) <= _QUOTED else f"{text[:_QUOTED]}…"
