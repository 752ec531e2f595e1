"""A look at point tracks: the first, the middle and the last frame with the points on them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scenec.datasets.colors import paint_instances
from scenec.schemas.correspondence import HIDDEN, VISIBLE
from scenec.schemas.files import atomic
from scenec.schemas.point_tracks import TrackSights

#: More points than that hide the picture.
_MOST = 200
#: Frames before one whose places a trail shows.
_TRAIL = 8
#: Of a point, in parts of the picture's width.
_RADIUS = 1 / 200


def write_track_sheet(path: Path, video: NDArray[np.uint8], sights: TrackSights) -> None:
    """Draws points, a color each: filled where visible, rings where hidden, and where they were.

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
    ids = np.arange(1, 1 + min(len(sights.code), _MOST), dtype=np.uint32)
    colors = [tuple(color) for color in paint_instances(ids[None])[0].tolist()]
    for place, frame in enumerate(shown):
        picture = Image.fromarray(video[frame])
        draw = ImageDraw.Draw(picture)
        for track, color in enumerate(colors):
            first = max(0, frame - _TRAIL)
            # Where it was without a break, within the picture.
            broken = np.flatnonzero(sights.code[track, first : frame + 1] > HIDDEN)
            first += broken[-1] + 1 if len(broken) else 0
            # Pillow's integers are centers of pixels.
            at = sights.pixel[track, first : frame + 1] - 0.5
            if not len(at):
                continue
            if len(at) > 1:
                draw.line([tuple(p) for p in at.tolist()], fill=color)
            x, y = at[-1].tolist()
            box = (x - radius, y - radius, x + radius, y + radius)
            visible = sights.code[track, frame] == VISIBLE
            draw.ellipse(box, fill=color if visible else None, outline=color)
        sheet.paste(picture, (place * width, 0))
    with atomic(path) as temporary:
        sheet.save(temporary, format="PNG")
