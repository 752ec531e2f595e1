"""OBJ files as models: parts, texture coordinates, normals, and which material each face has."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scenec.compiler.assets.looks import NO_VERTEX_COLORS, FileLook, linear_array
from scenec.compiler.assets.mtl import read_mtl
from scenec.compiler.assets.parts import MeshFileError, polygon_warnings
from scenec.compiler.assets.pictures import companion
from scenec.compiler.assets.shells import ParsedModel, Shell
from scenec.compiler.assets.trimesh_file import sound
from scenec.schemas.polygons import triangulate

_NUMBER = r"[-+]?(?:\d++\.?\d*+|\.\d++|(?i:nan|inf(?:inity)?))(?:[eE][-+]?\d++)?"
#: A vertex without three numbers, or a face that is no list of indices other than 0.
_OBJ_FAULT = re.compile(
    rf"\n(?:v(?! +{_NUMBER} +{_NUMBER} +{_NUMBER}[ \n])"
    r"|f(?!(?: +-?0*+[1-9]\d*+(?:/-?\d*+){0,2})+ *\n))(?: .*)?(?=\n)"
)
_FREE_FORM = re.compile(r"\n(?:curv2?|surf|cstype|bmat|parm) ")
#: Texture coordinates and normals of a corner.
_REFERENCES = re.compile(r"/\S*")
#: Statements that only looks need.
_OF_LOOKS = frozenset({"vt", "vn", "usemtl", "mtllib"})


def read_obj(file: Path, looks: bool) -> ParsedModel:
    """Reads an ``.obj`` file and, with its looks, its libraries of materials.

    Parts are its objects (``o``) or, where it has none, its groups (``g``).

    Raises:
        MeshFileError: It is not sound; a library or a picture is missing.
    """
    with sound(".obj"):
        return _ObjReader(file, looks).model()


class _ObjReader:
    """One pass over the lines; what a face names is resolved where it stands."""

    def __init__(self, file: Path, looks: bool):
        self._file = file
        self._with_looks = looks
        text = _text(file.read_bytes())
        self._keyword = "o" if "\no " in text else "g"
        self._positions: list[str] = []
        self._coordinates: list[str] = []
        self._directions: list[str] = []
        self._faces: list[str] = []
        #: First face, part and material of each stretch of faces that share them.
        self._runs: list[tuple[int, int, int]] = []
        self._parts: dict[str, int] = {}
        self._looks: dict[str, int] = {}
        self._libraries: list[str] = []
        self._lost_colors = False
        part, look, changed = "", -1, True
        for line in text.split("\n"):
            key, _, rest = line.partition(" ")
            if not looks and key in _OF_LOOKS:
                continue
            if key == "f":
                if not looks and "/" in rest:
                    rest = _REFERENCES.sub("", rest)
                if changed:
                    number = self._parts.setdefault(part, len(self._parts))
                    self._runs.append((len(self._faces), number, look))
                    changed = False
                if "-" in rest:
                    rest = " ".join(map(self._forward, rest.split()))
                self._faces.append(rest)
            elif key == "v":
                self._positions.append(rest)
            elif key == "vt":
                self._coordinates.append(rest)
            elif key == "vn":
                self._directions.append(rest)
            elif key == self._keyword:
                part, changed = rest.strip(), True
            elif key == "usemtl":
                look, changed = self._looks.setdefault(rest.strip(), len(self._looks)), True
            elif key == "mtllib" and rest.strip() not in self._libraries:
                self._libraries.append(rest.strip())

    def _forward(self, word: str) -> str:
        lists = (self._positions, self._coordinates, self._directions)
        out = []
        for spelled, values in zip(word.split("/"), lists, strict=False):
            number = int(spelled) if spelled else 0
            if number < 0 and number + len(values) < 0:
                raise MeshFileError(f"a face uses vertex {number} of {len(values)}")
            out.append(str(number + len(values) + 1 if number < 0 else number))
        return "/".join(out)

    def model(self) -> ParsedModel:
        points, tints = self._points()
        counts = np.array([len(face.split()) for face in self._faces], np.int64)
        corners = self._corners() - 1
        cut = triangulate(points, corners[:, 0], counts)
        spelled, polygon = corners[cut.corners], cut.polygon
        faces = spelled[..., 0]
        if len(faces) and faces.max() >= len(points):
            raise MeshFileError(f"a face uses vertex {faces.max()} (from 0) of {len(points)}")
        uv = self._at_corners(self._coordinates, spelled[..., 1], 2, "texture coordinate")
        normals = self._at_corners(self._directions, spelled[..., 2], 3, "normal")
        looks, companions, notes = self._materials()
        runs = np.array(self._runs, np.int64).reshape(-1, 3)
        lengths = np.diff(np.append(runs[:, 0], len(self._faces)))
        part_of, look_of = (np.repeat(runs[:, k], lengths)[polygon] for k in (1, 2))
        whole = Shell(
            "",
            points,
            faces,
            {} if uv is None else {"vt": uv},
            normals,
            None if tints is None else tints[faces],
            look_of,
        )
        shells = []
        order = np.argsort(part_of, kind="stable")
        ends = np.cumsum(np.bincount(part_of, minlength=len(self._parts))).tolist()
        for name, start, end in zip(self._parts, [0, *ends], ends, strict=False):
            own = order[start:end]
            shell = replace(whole.chosen(own), path=name)
            has_uv = uv is not None and (spelled[own, :, 1] >= 0).any()
            shells.append(shell if has_uv else replace(shell, uv={}))
        notes += (NO_VERTEX_COLORS,) * self._lost_colors
        warnings = polygon_warnings(cut.faults)
        return ParsedModel(tuple(shells), looks, None, None, companions, notes, warnings)

    def _corners(self) -> NDArray[np.int64]:
        """Position, texture coordinate and normal of each face's corners, from 1, 0 for none."""
        text = " ".join(self._faces)
        if "/" not in text:
            positions = np.fromstring(text, np.int64, sep=" ")
            return np.stack([positions, 0 * positions, 0 * positions], axis=1)
        # Corners are mostly spelled several times: each spelling is read once.
        words = text.split()
        distinct = {word: i for i, word in enumerate(dict.fromkeys(words))}
        corners = np.fromiter(map(distinct.__getitem__, words), np.int64, len(words))
        return np.array([self._key(word) for word in distinct], np.int64).reshape(-1, 3)[corners]

    def _points(self) -> tuple[NDArray[np.float64], NDArray[np.float64] | None]:
        text = " ".join(self._positions)
        # Each line has three numbers or more, see ``_text``.
        if text.count(" ") == 3 * len(self._positions) - 1:
            return np.fromstring(text, sep=" ").reshape(-1, 3), None
        rows = [line.split() for line in self._positions]
        points = _numbers(rows, 3)
        # Three more numbers are a color, as MeshLab and others write it; one more is a weight.
        colored = sum(len(row) >= 6 for row in rows)
        if not self._with_looks or colored < len(rows):
            self._lost_colors = self._with_looks and colored > 0
            return points, None
        return points, linear_array(np.nan_to_num(_numbers([row[3:] for row in rows], 3)))

    @staticmethod
    def _key(word: str) -> tuple[int, int, int]:
        first, second, third = [*word.split("/"), "", ""][:3]
        return int(first), int(second or 0), int(third or 0)

    def _at_corners(
        self, lines: list[str], index: NDArray[np.int64], width: int, what: str
    ) -> NDArray[np.float64] | None:
        """Values at the corners; 0 where a face names none."""
        if not lines or not index.size or index.max() < 0:
            return None
        if index.max() >= len(lines):
            raise MeshFileError(f"a face uses {what} {index.max()} (from 0) of {len(lines)}")
        zeros = ["0"] * width
        return _numbers([*((line.split() + zeros)[:width] for line in lines), zeros], width)[index]

    def _materials(self) -> tuple[tuple[FileLook, ...], tuple[Path, ...], tuple[str, ...]]:
        files: list[Path] = []
        look_of: dict[str, FileLook] = {}
        for library in self._libraries:
            for path in self._library(library):
                if path not in files:
                    files.append(path)
                for name, look in read_mtl(path, files.append).items():
                    look_of.setdefault(name, look)
        notes = []
        looks = []
        for name in self._looks:
            if name not in look_of:
                where = "its libraries do not have" if self._libraries else "it has no library for"
                notes.append(f"{where} the material {name!r}, which is shown in gray")
            looks.append(look_of.get(name, FileLook(name)))
        return tuple(looks), tuple(dict.fromkeys(files)), tuple(notes)

    def _library(self, words: str) -> list[Path]:
        """One name with spaces, or several without."""
        try:
            return [companion(self._file, words, "material library")]
        except MeshFileError:
            names = words.split()
            if len(names) < 2:
                raise
            return [companion(self._file, name, "material library") for name in names]


def _numbers(rows: list[list[str]], width: int) -> NDArray[np.float64]:
    """The first words of each row as numbers, [rows, width]."""
    words = (float(word) for row in rows for word in row[:width])
    return np.fromiter(words, np.float64, width * len(rows)).reshape(-1, width)


def _text(data: bytes) -> str:
    """An OBJ file with one statement a line, words separated by spaces, between line feeds.

    Raises:
        MeshFileError: A vertex or a face is malformed, or there are free-form surfaces.
    """
    # What is not ASCII can stand in names and comments only.
    text = data.decode("utf-8-sig", errors="replace").replace("\r\n", "\n").replace("\r", "\n")
    text = "\n" + text.replace("\\\n", " ").replace("\t", " ") + "\n"
    if "\n " in text or " #" in text:
        text = re.sub(r"\n +", "\n", re.sub(r" +#.*", "", text))
    fault = _FREE_FORM.search(text)
    if fault:
        raise MeshFileError(f"{_line(text, fault)}: a free-form surface: export it as polygons")
    fault = _OBJ_FAULT.search(text)
    if fault:
        kind, expected = (
            ("vertex", "three numbers")
            if fault[0].startswith("\nv")
            else ("face", "vertices, counted from 1")
        )
        raise MeshFileError(
            f"{_line(text, fault)}: {fault[0].strip()[:60]!r} is no {kind} of an OBJ file: "
            f"expected {expected}"
        )
    return text


def _line(text: str, place: re.Match[str]) -> str:
    return f"line {text.count('\n', 0, place.start()) + 1}"
