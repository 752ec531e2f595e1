"""Shows point tracks: the first, the middle and the last frame with the points on them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scenec.schemas.correspondence import HIDDEN
from scenec.schemas.files import atomic
from scenec.schemas.point_tracks import TrackSights

#: More points than that hide the picture.
_MOST = 200
#: Frames before one whose places a trail shows.
_TRAIL = 8
#: Of a point, in parts of the picture's width.
_RADIUS = 1 / 200
#: Of a step of a trail where the point is hidden.
_DASHES = 3
#: Colors that eyes of all kinds tell apart (Okabe and Ito 2008), in turn.
_COLORS = ("#e69f00", "#56b4e9", "#009e73", "#f0e442", "#0072b2", "#d55e00", "#cc79a7")


def write_track_sheet(path: Path, video: NDArray[np.uint8], sights: TrackSights) -> None:
    """Writes the first, the middle and the last frame with points on them (``draw_tracks``).

    Args:
        path: The .png.
        video: uint8 [frames, h, w, 3].
        sights: [n, frames].
    """
    from PIL import Image

    count = len(video)
    shown = sorted({0, count // 2, count - 1})
    row = [draw_tracks(video[frame], sights.pixel, sights.code, frame) for frame in shown]
    with atomic(path) as temporary:
        Image.fromarray(np.hstack(row)).save(temporary, format="PNG")


def draw_tracks(
    picture: NDArray[np.uint8], pixel: NDArray[np.float64], code: NDArray[np.integer], frame: int
) -> NDArray[np.uint8]:
    """Returns a picture with points on it, a color each, and where they were.

    A point is filled where it is visible and a ring where it is hidden; its trail is dashed there.

    Args:
        picture: uint8 [h, w, 3].
        pixel, code: Places, float64 [n, frames, 2], and what is seen of them, [n, frames].
        frame: Which of the frames the picture is.
    """
    from PIL import Image, ImageDraw

    radius = max(1.5, _RADIUS * picture.shape[1])
    drawn = Image.fromarray(picture)
    draw = ImageDraw.Draw(drawn)
    for track in range(min(len(code), _MOST)):
        color = _COLORS[track % len(_COLORS)]
        first = max(0, frame - _TRAIL)
        # Where it was without a break, within the picture.
        broken = np.flatnonzero(code[track, first : frame + 1] > HIDDEN)
        first += broken[-1] + 1 if len(broken) else 0
        # Pillow's integers are centers of pixels.
        at = pixel[track, first : frame + 1] - 0.5
        if not len(at):
            continue
        hidden = code[track, first : frame + 1] == HIDDEN
        for k, pieces in enumerate(np.where(hidden[1:] | hidden[:-1], _DASHES, 1).tolist()):
            ends = at[k] + np.linspace(0.0, 1.0, 2 * pieces)[:, None] * (at[k + 1] - at[k])
            for start, end in ends.reshape(-1, 2, 2).tolist():
                draw.line([*start, *end], fill=color, width=round(0.7 * radius))
        x, y = at[-1].tolist()
        box = (x - radius, y - radius, x + radius, y + radius)
        draw.ellipse(box, fill=None if hidden[-1] else color, outline=color)
    return np.asarray(drawn)
