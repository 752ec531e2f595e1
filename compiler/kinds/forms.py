"""Forms: what values keys take, where many keys take the same.

Kinds of other packages name them in their ``SCHEMA`` by the names in lower case, as
``{"$ref": "forms.schema.json#/$defs/length_per_batch"}``.
"""

from __future__ import annotations

from typing import Any

from scenec.compiler.kinds.declare import Form, bounded
from scenec.schemas.passes import PASSES

#: What references to definitions begin with.
DEFS = "#/$defs/"
#: One of the values that the field's annotation lists: ``Literal["near", "far"]``.
CHOICE = Form({"enum": "of annotation"})
TEXT = Form({"type": "string"})
WORDS = Form({"type": "string", "minLength": 1})
TRUTH = Form({"type": "boolean"})
#: Numbers that are not drawn.
CONSTANT = Form({"type": "number"})
COUNT = Form({"type": "integer"})


def one_of(*values: Any) -> Form:
    """Returns the form of one of some values."""
    return Form({"enum": list(values)})


def an(name: str, *, drawn: bool = False) -> Form:
    """Returns the form of an object, or of one of several kinds.

    Args:
        name: Its name in ``table``.
        drawn: Whether the kind gets the object itself, its numbers drawn, and not a mapping.
    """
    return Form({"$ref": f"{DEFS}{name}"}, name if drawn else "")


def file(kind: str) -> Form:
    """Returns the form of a file's name; its kind says what it must hold (``cfg.check_files``)."""
    return Form({"type": "string", "minLength": 1, "x-file": kind})


def list_of(
    form: Form, text: str = "", *, least: int | None = None, most: int | None = None,
    count: int | None = None, unique: bool = False,
) -> Form:  # fmt: skip
    """Returns the form of a list.

    Args:
        form: Of each entry.
        text: What an entry is.
        least, most: How many there are.
        count: The same, if there is one number only.
        unique: Whether none stands twice.
    """
    each = {**({"description": text} if text else {}), **form.keywords}
    found = {"type": "array", "minItems": count or least, "maxItems": count or most, "items": each}
    if unique:
        found["uniqueItems"] = True
    return Form({name: value for name, value in found.items() if value is not None})


def named(form: Form, text: str, *, by: str, least: int | None = None) -> Form:
    """Returns the form of an object whose keys are names that the cfg gives.

    Args:
        form: Of each value.
        text: What a value is.
        by: What is named so, in a word.
        least: How many there are.
    """
    found = {"type": "object", "propertyNames": dict(NAME.keywords), "minProperties": least}
    found["additionalProperties"] = {"description": text, **form.keywords}
    return Form({**{k: v for k, v in found.items() if v is not None}, "x-name": by})


def word_or(word: str, form: Form) -> Form:
    """Returns the form of a word, or of a list in its place."""
    entries = {name: value for name, value in form.keywords.items() if name != "type"}
    either = {"type": ["string", "array"], "if": {"type": "string"}, "then": {"enum": [word]}}
    return Form({**either, "else": entries})


NAME = Form({"type": "string", "pattern": "^[A-Za-z_][A-Za-z0-9_]*$(?!\\n)"}).but(
    description="A name: letters, digits and underscores, no digit first."
)
PER_BATCH = Form({"$ref": "#/$defs/number", "x-per": "batch", "x-per-allowed": ["batch"]})
PER_SAMPLE = Form(
    {"$ref": "#/$defs/number", "x-per": "sample", "x-per-allowed": ["sample", "batch"]}
)
PER_INSTANCE = Form(
    {"$ref": "#/$defs/number", "x-per": "instance", "x-per-allowed": ["instance", "batch"]}
)
PER = one_of("batch", "sample", "instance").but(
    description=("When it is drawn. Left out, as the key says after its type; else once a batch.")
)
FRACTION_PER_BATCH = bounded(PER_BATCH, at_least=0, at_most=1)
FRACTION_PER_SAMPLE = bounded(PER_SAMPLE, at_least=0, at_most=1)
FRACTION_PER_INSTANCE = bounded(PER_INSTANCE, at_least=0, at_most=1)
LENGTH_PER_BATCH = bounded(PER_BATCH, unit="m")
LENGTH_PER_SAMPLE = bounded(PER_SAMPLE, unit="m")
LENGTH_PER_INSTANCE = bounded(PER_INSTANCE, unit="m")
ANGLE_PER_BATCH = bounded(PER_BATCH, unit="°")
ANGLE_PER_SAMPLE = bounded(PER_SAMPLE, unit="°")
#: Bearings and turns, and coordinates and heights, of whatever sign.
TURN_PER_BATCH = bounded(ANGLE_PER_BATCH, at_least=-100_000, at_most=100_000)
TURN_PER_SAMPLE = bounded(ANGLE_PER_SAMPLE, at_least=-100_000, at_most=100_000)
COORDINATE_PER_BATCH = bounded(LENGTH_PER_BATCH, at_least=-10_000_000, at_most=10_000_000)
COORDINATE_PER_SAMPLE = bounded(LENGTH_PER_SAMPLE, at_least=-10_000_000, at_most=10_000_000)
WHOLE_PER_BATCH = PER_BATCH.but(x_kind="integer")
RAGGED = an("condition_ragged", drawn=True).but(description="Noise that makes the border ragged.")
SAMPLING = an("pose_sampling", drawn=True).but(
    default={}, description="At which times of the motion the samples are."
)
SOFTNESS_M = bounded(LENGTH_PER_BATCH, at_least=0, at_most=1_000_000_000).but(
    default=0,
    description=(
        "Width over which it fades about a bound, half on either side. On the ground at least an "
        "eighth of the change over a spacing."
    ),
)
LACUNARITY = bounded(PER_BATCH, at_least=1, at_most=8).but(
    default=2, description="Ratio of the frequencies of successive octaves."
)
GAIN = bounded(PER_BATCH, at_least=0, at_most=2).but(
    default=0.5, description="Ratio of the amplitudes of successive octaves."
)
BACKGROUND = FRACTION_PER_BATCH.but(
    default=0, description="Part of the objects that is spread evenly instead."
)
NOISE_SCALE_M = bounded(LENGTH_PER_BATCH, above=0, at_most=1_000_000_000).but(
    description="Size of the largest features."
)
TIME_RANGE_S = list_of(
    bounded(PER_BATCH, above=0, at_most=1000000.0, unit="s"), "One end.", count=2
).but(default=[2e-05, 0.03], description="Shortest and longest exposure time.")
ISO_RANGE = list_of(bounded(PER_BATCH, above=0, at_most=1000000000.0), "One end.", count=2).but(
    default=[200, 6400], description="Lowest and highest speed."
)
SUN_ELEVATION_DEG = bounded(ANGLE_PER_SAMPLE, at_least=-90, at_most=90).but(
    default=45, description="Angle above the horizon."
)
MOUNT_POSITION_M = list_of(
    bounded(LENGTH_PER_BATCH, at_least=-1_000_000, at_most=1_000_000), "Along one axis.", count=3
).but(default=[0, 0, 0], description="Position: right, down, forward.")
MOUNT_ROTATION_DEG = list_of(TURN_PER_BATCH, "About one axis.", count=3).but(
    default=[0, 0, 0], description="Rotations about the rig's x, then y, then z axis."
)
POINT_M = list_of(
    bounded(LENGTH_PER_BATCH, at_least=-10_000_000, at_most=10_000_000), "One coordinate.", count=2
)
WAYPOINTS_M = list_of(POINT_M, "One point.", least=1).but(
    description="Points of the way in plan: x (east) and y (north), meters."
)
WIND_DEG = bounded(ANGLE_PER_BATCH, at_least=-360, at_most=360).but(
    default=0, description="Where the wind blows to: 0 is east (+x), 90 north (+y)."
)
MASK = list_of(an("relief_mask"), "One condition.", least=1).but(
    description=(
        "Where the operator acts: conditions whose product is the mask. Left out, everywhere."
    )
)
COLOR = list_of(FRACTION_PER_SAMPLE, "Linear Rec.709 red, green or blue.", count=3).but(
    x_color=True
)
GROUND_COLOR = COLOR.but(
    default=[0.3, 0.26, 0.22],
    description="Albedo of far ground below the horizon, linear Rec.709.",
)
SKY_LABELS = an("label_choice").but(
    default={}, description="The sky's label; a level left out has label 0."
)
SKY_LABELS_BELOW = an("label_choice").but(
    default={},
    x_sparse=True,
    description="Label below the horizontal plane through the camera where no surface is: the "
    "ground in the sky's picture. A level left out has the sky's label.",
)
SURFACE_RELIEF_M = bounded(LENGTH_PER_BATCH, at_least=0, at_most=1_000_000).but(
    description=(
        "Root mean square of the relief's heights, which make the normals; left out, as in nature."
    )
)
SURFACE_CONTRAST = bounded(PER_BATCH, at_least=0, at_most=2).but(
    default=1, description="How much color and roughness vary: 0 not at all, 1 as in nature."
)
SURFACE_RESOLUTION = one_of(64, 128, 256, 512, 1024, 2048, 4096).but(
    default=1024, description="Pixels along a side of the pictures."
)
SURFACE_DISPLACEMENT = TRUTH.but(
    default=False,
    description=(
        "Whether the relief becomes geometry near cameras, for materials of the ground projected "
        "from above; normals keep what is finer."
    ),
)
OUTPUT = one_of(*PASSES).but(x_open="scenec.passes", description="One channel.")
