"""Which bodies fall together: those that can meet; each such group is simulated by itself."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from scenec.compiler.mesh.surface import GroundSurface
from scenec.schemas.errors import SceneError
from scenec.settle.bodies import Body
from scenec.settle.world import Fallen, Options, fall

#: Bodies of one group must not differ more in size: solvers lose what is so light under what is so
#: heavy, and the time that the large ones take is counted in steps for the small ones.
MOST_RATIO = 100.0
#: Bodies whose circles in plan, so much wider, overlap fall together.
_WIDER = 2.0


def fall_apart(
    bodies: Sequence[Body],
    obstacles: Sequence[Body],
    surface: GroundSurface,
    options: Options,
    say: Callable[[str], None],
) -> list[Fallen]:
    """Lets bodies fall, group by group; groups that end up in each other fall again, together.

    Args:
        bodies: What falls.
        obstacles: What it may fall onto.
        surface: The ground.
        options: How.
        say: Called with a line of text for each group.

    Raises:
        SceneError: A group's bodies differ too much in size, or the library fails.
    """
    waiting = groups(bodies, _WIDER)
    done: list[tuple[list[int], Fallen]] = []
    while waiting:
        for group in waiting:
            chosen = [bodies[n] for n in group]
            _require_like_sizes(chosen)
            fallen = fall(chosen, obstacles, surface, options)
            done.append((group, fallen))
            number = sum(len(members) for members, _ in done)
            say(
                f"{number}/{len(bodies)} objects settled: {len(group)} together in "
                f"{fallen.steps:,} steps" + ("" if fallen.rested else ", not at rest")
            )
        waiting = []
        for joined in _met(done):
            waiting.append(sorted(n for k in joined for n in done[k][0]))
        done = [entry for entry in done if not any(entry[0][0] in group for group in waiting)]
    return [fallen for _, fallen in sorted(done, key=lambda entry: entry[0][0])]


def groups(bodies: Sequence[Body], wider: float) -> list[list[int]]:
    """Indices of bodies whose circles in plan overlap, directly or through others."""
    centers = np.array([body.center[:2] for body in bodies])
    radii = wider * np.array([body.radius for body in bodies])
    label = np.arange(len(bodies))
    for n in range(len(bodies)):
        away = centers - centers[n]
        near = (away * away).sum(axis=1) < (radii + radii[n]) * (radii + radii[n])
        label[np.isin(label, label[near])] = label[near].min()
    return [np.flatnonzero(label == one).tolist() for one in np.unique(label)]


def _met(done: Sequence[tuple[list[int], Fallen]]) -> list[list[int]]:
    """Sets of groups whose bodies' balls now overlap, as indices into ``done``."""
    owner = np.concatenate([np.full(len(members), k) for k, (members, _) in enumerate(done)])
    settled = [body for _, fallen in done for body in fallen.bodies]
    centers = np.array([body.center for body in settled])
    radii = np.array([body.radius for body in settled])
    label = np.arange(len(done))
    for n in range(len(settled)):
        away = centers - centers[n]
        near = (away * away).sum(axis=1) < (radii + radii[n]) * (radii + radii[n])
        met = label[owner[near]]
        label[np.isin(label, met)] = met.min()
    found = [np.flatnonzero(label == one).tolist() for one in np.unique(label)]
    return [group for group in found if len(group) > 1]


def _require_like_sizes(bodies: Sequence[Body]) -> None:
    small = min(bodies, key=lambda body: body.radius)
    large = max(bodies, key=lambda body: body.radius)
    if large.radius > MOST_RATIO * small.radius:
        raise SceneError(
            f"objects/{large.owner}: object {large.id} is {2 * large.radius:.4g} m large and near "
            f"objects/{small.owner}: object {small.id} of {2 * small.radius:.4g} m; what falls "
            f"together may differ by a factor of {MOST_RATIO:g}: settle them one class at a time"
        )
