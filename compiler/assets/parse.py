"""Files of meshes as they are: one reader a format, for terrain and for objects alike.

What is read of each format:

- OBJ: groups, objects, texture coordinates, normals, ``usemtl`` with its MTL files; Kd is linear,
  Ns is (1 - roughness)^2 * 1000, map_Kd replaces Kd, all as Blender writes and reads them.
- glTF: pbrMetallicRoughness with its pictures, KHR_texture_transform, ior, specular.
- PLY: texture coordinates of vertices with ``comment TextureFile``; vertex colors.
- USD: UsdPreviewSurface and UsdUVTexture, by prim or GeomSubset.
- STL and OFF: geometry only.
- ``.blend``: see ``blend``.

Pictures of opacity are masks. Other opacity, emission, displacement, coats and the like have no
place in the surface model: each that a file asks for is named in the notes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from importlib import import_module
from itertools import chain
from pathlib import Path

from scenec.compiler.assets.parts import MeshFileError
from scenec.compiler.assets.shells import ParsedModel
from scenec.schemas.errors import SceneError
from scenec.schemas.udim import is_tiled, tiles_of

GLTF = (".glb", ".gltf")
_USD = (".usd", ".usda", ".usdc", ".usdz")
#: Module and function that read each ending; imported when needed: each brings its own library.
_READERS = {
    ".obj": ("obj_model", "read_obj"),
    ".ply": ("ply_model", "read_ply"),
    ".stl": ("trimesh_file", "read_stl"),
    ".off": ("off_model", "read_off"),
    **dict.fromkeys(GLTF, ("gltf_model", "read_gltf")),
    **dict.fromkeys(_USD, ("usd_model", "read_usd_model")),
    ".blend": ("blend", "read_blend"),
}
#: Endings of the files that can be read.
SUFFIXES = tuple(_READERS)
#: Those of meshes for terrain: Blender's arithmetic changes with the CPU.
MESH_SUFFIXES = SUFFIXES[:-1]
#: What files of each format begin with, to tell a wrong ending.
_MAGIC = {
    b"ply\n": ".ply", b"ply\r": ".ply", b"glTF": ".glb", b"PXR-USDC": ".usdc", b"#usda": ".usda",
}  # fmt: skip


def parse_model(file: Path, *, looks: bool = True) -> ParsedModel:
    """A file's parts and materials as it has them, unchecked.

    Args:
        file: A file of one of ``SUFFIXES``. PLY and STL need the extra ``meshes``, ``.blend`` the
            extra ``cycles``.
        looks: Whether to read what a model has besides points and faces, where that takes time or
            other files; without it, only files of ``MESH_SUFFIXES`` are taken.

    Raises:
        SceneError: The file cannot be read, is none of the formats, or refers to what is not there.
    """
    with faults_of(file):
        suffix, known = _checked_suffix(file), SUFFIXES if looks else MESH_SUFFIXES
        if suffix not in known:
            raise MeshFileError(
                f"expected a {'model' if looks else 'mesh'} ({', '.join(known)}), not "
                f"{suffix or 'a file without an ending'}"
            )
        module, name = _READERS[suffix]
        read: Callable[..., ParsedModel] = getattr(
            import_module(f"scenec.compiler.assets.{module}"), name
        )
        parsed = read(file, looks)
        files = ([*tiles_of(p).values()] if is_tiled(p) else [p] for p in parsed.companions)
        return replace(parsed, companions=tuple(chain.from_iterable(files)))


@contextmanager
def faults_of(file: Path) -> Iterator[None]:
    """Checks that there is something to read, and names the file in what goes wrong within.

    Raises:
        SceneError: There is nothing to read, or what the block raises as ``MeshFileError``.
    """
    try:
        if not file.is_file():
            raise MeshFileError("not a file" if file.exists() else "there is no such file")
        if file.stat().st_size == 0:
            raise MeshFileError("the file is empty")
        yield
    except MeshFileError as fault:
        raise SceneError(f"{file.name}: {fault}") from fault
    except (OSError, MemoryError) as error:
        reason = str(error) or "it does not fit into memory"
        raise SceneError(f"{file.name}: cannot be read: {reason}") from error


def _checked_suffix(file: Path) -> str:
    """The file's ending in lower case, once its first bytes do not speak against it.

    Raises:
        MeshFileError: They are those of another format.
    """
    suffix = file.suffix.lower()
    with file.open("rb") as stream:
        head = stream.read(8)
    for magic, true_suffix in _MAGIC.items():
        if head.startswith(magic) and not _fits(suffix, true_suffix):
            raise MeshFileError(f"its content is that of a {true_suffix} file: rename it")
    if suffix == ".ply" and not head.startswith((b"ply\n", b"ply\r")):
        raise MeshFileError("not a PLY file: it does not begin with 'ply'")
    return suffix


def _fits(suffix: str, true_suffix: str) -> bool:
    return suffix == true_suffix or (suffix == ".usd" and true_suffix in _USD)
