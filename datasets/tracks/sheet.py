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
    """Draws points, a color each, and where they were.

    A point is filled where it is visible and a ring where it is hidden; its trail is dashed there.

    Args:
        path: The .png.
        video: uint8 [frames, h, w, 3].
        sights: [n, frames].
    """
    from PIL import Image, ImageDraw

    count = len(video)
    shown = sorted({0, count // 2, count - 1})
    height, width = video.shape[1:3]
    radius = max(1.5, _RADIUS * width)
    sheet = Image.new("RGB", (width * len(shown), height))
    for place, frame in enumerate(shown):
        picture = Image.fromarray(video[frame])
        draw = ImageDraw.Draw(picture)
        for track in range(min(len(sights.code), _MOST)):
            color = _COLORS[track % len(_COLORS)]
            first = max(0, frame - _TRAIL)
            # Where it was without a break, within the picture.
            broken = np.flatnonzero(sights.code[track, first : frame + 1] > HIDDEN)
            first += broken[-1] + 1 if len(broken) else 0
            # Pillow's integers are centers of pixels.
            at = sights.pixel[track, first : frame + 1] - 0.5
            if not len(at):
                continue
            hidden = sights.code[track, first : frame + 1] == HIDDEN
            for k, pieces in enumerate(np.where(hidden[1:] | hidden[:-1], _DASHES, 1).tolist()):
                ends = at[k] + np.linspace(0.0, 1.0, 2 * pieces)[:, None] * (at[k + 1] - at[k])
                for start, end in ends.reshape(-1, 2, 2).tolist():
                    draw.line([*start, *end], fill=color, width=round(0.7 * radius))
            x, y = at[-1].tolist()
            box = (x - radius, y - radius, x + radius, y + radius)
            draw.ellipse(box, fill=None if hidden[-1] else color, outline=color)
        sheet.paste(picture, (place * width, 0))
    with atomic(path) as temporary:
        sheet.save(temporary, format="PNG")
