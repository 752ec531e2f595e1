"""Point tracks of batches: what ``export --format tapvid`` makes of stages and their frames."""

TAPVID = "tapvid"
SUMMARY = "stages and frames: points followed on surfaces, TAP-Vid's pickles, arrays and tables"
#: Options -> what they are if nobody says, and a line of help.
SETTINGS: dict[str, tuple[str, str]] = {
    "points": ("256", "how many of each camera are followed"),
    "strata": ("none", "instance or label.<level>: as many on each of these as there are"),
    "queries": ("all", "frames that points are chosen in: all, or the first"),
    "places": ("random", "random within pixels, or their centers"),
    "seed": ("0", "of the choice of points"),
    "camera": ("", "in whose pictures all cameras' points are chosen (default: in each one's own)"),
    "video": ("yes", "no: arrays and tables alone, which need no frames"),
}
