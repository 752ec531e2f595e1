"""Sorts the pictures of a folder by their names into the set of a material.

A name is taken apart into words (at whatever is no letter or digit, and where case changes); the
last word that names a kind counts, so that ``metal_plate_02_diff_1k.jpg`` is a color. Words that
all names of a folder begin with are the set's own name, and say nothing.

The schemes are those of ambientCG (``Rock035_2K-JPG_NormalGL``), Poly Haven
(``aerial_rocks_02_nor_gl_1k``, and ``arm``: occlusion, roughness and metal in one), cgbookcase and
3dtextures (``_BaseColor``, ``_ambientOcclusion``, ``_height``), Quixel and textures.com
(``_Albedo``, ``_Gloss``), and Poliigon's, which OAISYS reads (``_COL``, ``_NRM``, ``_REFL``).
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import takewhile
from pathlib import Path

#: Kinds of pictures by the words that name them; several words stand in this order.
_WORDS: dict[str, tuple[str, ...]] = {
    "base_color": (
        "base color", "base colour", "basecolor", "basecolour", "color", "colour", "col", "diff",
        "diffuse", "albedo", "alb",
    ),
    "roughness": ("rough", "roughness", "rgh"),
    "gloss": ("gloss", "glossiness", "glossy", "smoothness"),
    "metallic": ("metal", "metallic", "metalness", "metallicity", "met"),
    "normal": ("normal", "normals", "normal map", "norm", "nor", "nrm", "nrml"),
    "ambient_occlusion": ("ambient occlusion", "ambientocclusion", "occlusion", "ao", "occ"),
    "displacement": ("displacement", "disp", "displace", "height", "height map", "heightmap"),
    "emission": ("emission", "emissive", "emit", "emis"),
    "packed": ("arm", "orm"),
    "": (
        "spec", "specular", "ref", "refl", "reflection", "reflectivity", "cavity", "bump",
        "opacity", "alpha", "translucency", "transmission", "mask", "curvature", "thickness",
        "fuzz",
    ),
}  # fmt: skip
_KINDS = {tuple(words.split()): kind for kind, many in _WORDS.items() for words in many}
_HANDS = {
    "gl": "opengl",
    "opengl": "opengl",
    "dx": "directx",
    "directx": "directx",
    "d3d": "directx",
}
_PREVIEWS = ("preview", "previews", "thumb", "thumbnail", "thumbs", "render", "sphere")
#: Endings of pictures that can be read, and of others that are pictures, too.
_READ = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".exr")
_OTHERS = (".tga", ".bmp", ".webp", ".hdr", ".psd", ".dds", ".gif", ".svg", ".jp2")
#: Kinds that ``packed`` holds in its red, green and blue.
PACKED = ("ambient_occlusion", "roughness", "metallic")
#: Kinds of which one stands for the other.
_SAME = {"gloss": "roughness", "roughness": "gloss"}


class TextureSetError(ValueError):
    """A folder that cannot be understood; the message lists what is in it."""


@dataclass(frozen=True)
class TextureSet:
    """Assigns the pictures of a folder to kinds of maps.

    Attributes:
        files: Name of the file by kind: "base_color", "roughness", "gloss", "metallic", "normal",
            "ambient_occlusion", "displacement", "emission", and "packed" where it has something
            that no other file has.
        normal_convention: "opengl", "directx", or None where the normals' name does not say.
        unused: Pictures whose names are understood, and which another one takes the place of, or
            the surface model has no place for.
        unknown: Pictures whose names are not understood.
    """

    files: dict[str, str]
    normal_convention: str | None
    unused: tuple[str, ...]
    unknown: tuple[str, ...]

    def unpacked(self, given: frozenset[str] = frozenset()) -> tuple[str, ...]:
        """Kinds that the packed picture is used for, beside those that have their own."""
        return unpacked({*self.files, *given})


def read_texture_set(folder: Path, given: frozenset[str] = frozenset()) -> TextureSet:
    """The set in a folder; see ``recognize``.

    Raises:
        TextureSetError: It cannot be understood.
        OSError: The folder cannot be read.
    """
    return recognize(sorted(path.name for path in folder.iterdir() if path.is_file()), given)


def recognize(names: Iterable[str], given: frozenset[str] = frozenset()) -> TextureSet:
    """Recognizes a material's maps among the files of a folder by their names.

    Of normals in both handednesses, OpenGL's are taken. Files that are no pictures, and previews,
    are passed over.

    Args:
        given: Kinds that come from elsewhere: none is taken from here.

    Raises:
        TextureSetError: Two files of one kind, or none whose name is understood.
    """
    names = sorted(names)
    pictures = {
        name: words
        for name in names
        if name.lower().endswith(_READ)
        for words in (_words(name),)
        if not any(word in _PREVIEWS for word in words)
    }
    own = _shared(list(pictures.values()))
    found = {name: _kind(words[own:]) for name, words in pictures.items()}
    if not any(found.values()):
        found = {name: _kind(words) for name, words in pictures.items()}
    unknown = [name for name, kind in found.items() if kind is None]
    unknown += [name for name in names if name.lower().endswith(_OTHERS) and name not in pictures]
    by_kind: dict[str, list[str]] = {}
    for name, kind in found.items():
        if kind is not None:
            by_kind.setdefault(kind, []).append(name)
    unused = by_kind.pop("", [])
    if not by_kind:
        listed = ", ".join(sorted({*pictures, *unknown})[:8]) or "nothing"
        raise TextureSetError(
            "no picture whose name says what it is: expected names such as rock_diff.jpg, "
            f"rock_rough.jpg, rock_nor_gl.png; found {listed}"
        )
    convention = None
    files: dict[str, str] = {}
    blocked = _with_same(set(given))
    for kind, candidates in by_kind.items():
        if kind in blocked:
            unused += candidates
            continue
        if kind == "normal":
            candidates, others, convention = _handed(candidates, pictures)
            unused += others
        if len(candidates) > 1:
            raise TextureSetError(
                f"{len(candidates)} pictures of one kind ({kind}): {', '.join(candidates)}; take "
                f"all but one away, or name one by the key {kind}"
            )
        files[kind] = candidates[0]
    if "roughness" in files and "gloss" in files:
        unused.append(files.pop("gloss"))
    made = TextureSet(files, convention, (), ())
    if "packed" in files and not made.unpacked(given):
        unused.append(files.pop("packed"))
    return TextureSet(files, convention, tuple(sorted(unused)), tuple(sorted(unknown)))


def unpacked(there: Iterable[str]) -> tuple[str, ...]:
    """Kinds that a packed picture is used for, of all kinds that there are; none without it."""
    kinds = _with_same(set(there))
    return tuple(kind for kind in PACKED if "packed" in kinds and kind not in kinds)


def _with_same(kinds: set[str]) -> set[str]:
    return kinds | {_SAME[kind] for kind in kinds if kind in _SAME}


def _words(name: str) -> list[str]:
    """Words of a name without its ending, in lower case; digits are words of their own."""
    stem = name.rsplit(".", 1)[0]
    parts = re.findall(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|\d+[kK]?|[A-Z]", stem)
    return [part.lower() for part in parts]


def _shared(many: list[list[str]]) -> int:
    """Counts the leading words that several lists have in common."""
    columns = zip(*many, strict=False) if len(many) > 1 else ()
    return sum(1 for _ in takewhile(lambda words: len(set(words)) == 1, columns))


def _kind(words: list[str]) -> str | None:
    """The kind that the last words name which name one; None: none does."""
    for end in range(len(words), 0, -1):
        for length in (2, 1):
            kind = _KINDS.get(tuple(words[max(end - length, 0) : end]))
            if kind is not None:
                return kind
        # NormalGL, written in one case.
        for hand in _HANDS:
            if words[end - 1] in (f"normal{hand}", f"nor{hand}"):
                return "normal"
    return None


def _handed(
    names: list[str], words: dict[str, list[str]]
) -> tuple[list[str], list[str], str | None]:
    """Splits pictures of normals into used and unused ones, and returns the former's convention."""
    hands: dict[str, str | None] = {}
    for name in names:
        said = [
            hand
            for word in words[name]
            for end, hand in _HANDS.items()
            if word in (end, f"normal{end}", f"nor{end}")
        ]
        hands[name] = said[-1] if said else None
    if set(hands.values()) == {"opengl", "directx"}:
        taken = [name for name in names if hands[name] == "opengl"]
        return taken, [name for name in names if name not in taken], "opengl"
    return names, [], hands[names[0]]
