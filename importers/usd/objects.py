"""Groups rows of a stage into objects, and finds where each is at each sample."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from scenec.backends.stage.scene import Motion, RenderScene
from scenec.importers.poses import similar
from scenec.importers.usd.scene import Scene

#: By how much of themselves matrices may differ that count as equal.
_SAME = 1e-7
#: Scale of an object at samples where it is hidden.
HIDDEN = 1e-9
#: Scales beyond these are of the model.

type Matrices = NDArray[np.float64]


@dataclass(frozen=True)
class Thing:
    """Describes one object.

    Attributes:
        number: Its local instance id, from 1.
        poses: To the world by an even scale and a turn, [1, 4, 4] or [samples, 4, 4].
        content: Its rows: mesh, and its place in the object's frame, [3, 4].
        even: The same, had its own scale been even; of the same length.
        notes: What differs from the stage.
    """

    number: int
    poses: Matrices
    content: tuple[tuple[int, Matrices], ...]
    even: tuple[tuple[int, Matrices], ...]
    notes: tuple[str, ...] = ()


@dataclass
class Class:
    """Groups objects of one class.

    Attributes:
        path: Of the prim that they are of.
        instances: Whether they are instances in the stage.
        rows: Those of each object, by its number.
    """

    path: str
    instances: bool
    rows: dict[int, list[int]] = field(default_factory=dict)


def things(scene: Scene, members: Class) -> Iterator[Thing]:
    """Yields the objects of a class; none of those that are scaled to nothing."""
    read = scene.read
    beyond = max(members.rows, default=0)
    for number, rows in members.rows.items():
        groups = _moving_together(read, rows)
        for k, group in enumerate(groups):
            note = ("its parts move by themselves: each is an instance of its own",)
            apart = len(groups) > 1 and members.instances
            if k:
                beyond += 1
            made = _thing(scene, beyond if k else number, group, note if apart else ())
            if made is not None:
                yield made


def _moving_together(read: RenderScene, rows: Sequence[int]) -> list[list[int]]:
    """Groups rows that keep their places in each other's frames over all samples."""
    motion = read.rows.motion
    if motion is None or len(rows) == 1 or not np.isin(rows, motion.rows).any():
        return [list(rows)]
    groups: list[tuple[Matrices, Matrices, list[int]]] = []
    for row in rows:
        at = _matrices(read, motion, row)
        poses = similar(at[..., :3])
        for theirs, first, group in groups:
            places = _inverted(theirs, at)
            shown = _shown(at)
            same = (shown == _shown(first)).all() and shown.any()
            if same and _equal(places[shown], places[int(np.argmax(shown))]):
                group.append(row)
                break
        else:
            linear, scale = poses
            made = np.concatenate([linear * scale[:, None, None], at[..., 3:]], axis=2)
            groups.append((made, at, [row]))
    return [group for _, _, group in groups]


def _thing(scene: Scene, number: int, rows: Sequence[int], notes: tuple[str, ...]) -> Thing | None:
    read, motion = scene.read, scene.read.rows.motion
    moves = motion is not None and bool(np.isin(rows, motion.rows).any())
    at = np.stack(
        [_matrices(read, motion, r) if moves else read.rows.to_world[r][None] for r in rows]
    )
    shown = _shown(at[0])
    if not shown.any():
        return None
    first = int(np.argmax(shown))
    # What the frame of the instance is, if its rows say where they are in it.
    places = [_place(read, row) for row in rows]
    frames = at[0] if places[0] is None else _without(at[0], places[0])
    # The frame that an object with the stage's own unit and axes has.
    upright = scene.frame.turn * scene.frame.meters_per_unit
    linear, scale = similar(frames[..., :3] @ np.linalg.inv(upright))
    poses = np.tile(np.eye(4), (len(frames), 1, 1))
    poses[:, :3, :3] = linear * scale[:, None, None]
    poses[:, :3, 3] = frames[..., 3] + scene.shift
    own = np.concatenate([poses[:, :3, :3], frames[..., 3:]], axis=2)
    content = [_inverted(own, each) for each in at]
    if any(not _equal(each[shown], each[first]) for each in content):
        notes = (*notes, "its uneven scale changes: its shape is that of the first sample")
    if not shown.all():
        poses[~shown, :3, :3] = poses[first, :3, :3] * (HIDDEN / scale[first])
        notes = (*notes, f"hidden by a scale of {HIDDEN:g} at {int((~shown).sum())} samples")
    base = np.column_stack([upright, np.zeros(3)])
    even = [
        each[first] if place is None else _product(base, place)
        for each, place in zip(content, places, strict=True)
    ]
    meshes = [int(read.rows.mesh[row]) for row in rows]
    return Thing(
        number,
        poses,
        tuple((mesh, each[first]) for mesh, each in zip(meshes, content, strict=True)),
        tuple(zip(meshes, even, strict=True)),
        notes,
    )


def key_of(content: Sequence[tuple[int, Matrices]]) -> bytes:
    """Makes bytes that are the same of contents that count as equal."""
    parts = []
    for mesh, place in content:
        step = _SAME * max(float(np.abs(place[:, :3]).max()), 1e-300)
        # Adding 0 makes -0 and 0 the same bytes.
        parts.append(np.append(np.rint(place / step) + 0.0, mesh).tobytes())
    return b"".join(parts)


def _matrices(read: RenderScene, motion: Motion | None, row: int) -> Matrices:
    """Returns where a row is at each sample, [samples, 3, 4]."""
    if motion is not None:
        at = int(np.searchsorted(motion.rows, row))
        if at < len(motion.rows) and motion.rows[at] == row:
            return motion.to_world[:, at]
    return np.repeat(read.rows.to_world[row][None], read.samples, axis=0)


def _place(read: RenderScene, row: int) -> Matrices | None:
    """Returns a row's place in its instance, [3, 4]; None if it changes, or has no inverse."""
    if read.rows.part is None or read.rows.part[row] < 0:
        return None
    place: Matrices = read.parts[read.rows.part[row]]
    sizes = np.linalg.svd(place[:, :3], compute_uv=False)
    return place if sizes[2] > 1e-9 * sizes[0] else None


def _shown(at: Matrices) -> NDArray[np.bool_]:
    shown: NDArray[np.bool_] = at[..., :3].any(axis=(-2, -1))
    return shown


def _equal(many: Matrices, one: Matrices) -> bool:
    return bool(np.abs(many - one).max(initial=0.0) <= 10 * _SAME * np.abs(one).max())


def _product(a: Matrices, b: Matrices) -> Matrices:
    out: Matrices = a[..., :3] @ b
    out[..., 3] += a[..., 3]
    return out


def _without(at: Matrices, place: Matrices) -> Matrices:
    """Returns the frames in which a place is ``at``."""
    inverse = np.linalg.inv(place[:, :3])
    back = np.column_stack([inverse, -inverse @ place[:, 3]])
    out: Matrices = at[..., :3] @ back
    out[..., 3] += at[..., 3]
    return out


def _inverted(poses: Matrices, at: Matrices) -> Matrices:
    """Moves matrices into the frames of poses that are regular, [n, 3, 4]."""
    inverse = np.linalg.inv(poses[..., :3])
    return inverse @ np.concatenate([at[..., :3], at[..., 3:] - poses[..., 3:]], axis=-1)
