"""The files of a stage: each that it names is there, and has the bytes that its manifest states."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path

from pxr import Ar, Sdf, Tf, Usd, UsdShade

from scenec.backends.stage import values
from scenec.backends.stage.materialx import materialx_layer
from scenec.backends.stage.materialx_networks import preview_networks
from scenec.backends.stage.values import said
from scenec.schemas.crate import crate_fault
from scenec.schemas.errors import StageError
from scenec.schemas.files import sha256
from scenec.schemas.manifest import MANIFEST, digest_of_files, files_of_stage
from scenec.schemas.native import commentary, native_reading
from scenec.schemas.omnipbr import as_preview_surface
from scenec.schemas.packages import in_package
from scenec.schemas.udim import is_tiled, tiles_of

#: Lines of one error.
_MOST_LINES = 8
#: What the digest of a stage that is not whole has in the place of a path: no file is named so.
_MISSING = "<missing>"

# Texts of OpenUSD 26 (pxr/usd/pcp/errors.cpp): its Python classes say neither file nor arc. A text
# that none of these matches is passed on as it is.
_SUBLAYER = re.compile(r"Could not load sublayer @(.+?)@ of layer @(.+?)@(?: -- (.*?))?; skipping")
_ASSET = re.compile(
    r"Could not open asset @(.+?)@ for (\w+) introduced by @(.+?)@<.*?>(?: -- (.*))?\.$"
)
_PRIM = re.compile(r"Unresolved (\w+) prim path @(.+?)@<(.*?)> introduced by @(.+?)@<.*?>")


class Sources:
    """Tracks the files that a stage is read from, and those that are missing.

    Args:
        path: Root layer.
        allow_missing: Whether a stage that lacks files is read all the same.
    """

    def __init__(self, path: Path, allow_missing: bool = False) -> None:
        self._path = path
        self._folder = os.path.dirname(os.path.abspath(path))
        self._allowed = allow_missing
        self._lines: dict[str, None] = {}
        self._warnings: dict[str, None] = {}
        self._digests: dict[str, str] = {}
        self._pictures: dict[str, Path] = {}
        # Pictures and value clips, which are no layers that USD would name.
        self._beside: set[str] = set()
        self._listed = False
        # Translations of MDL, by the path of the material; in a stage of their own.
        self._translations: dict[Sdf.Path, UsdShade.Material] = {}
        self._scratch = Usd.Stage.CreateInMemory()
        self._materialx: dict[str, Sdf.Layer | None] = {}
        # Layers whose references lead to those, as (layer, what is authored, what stands there).
        self._replaced: list[tuple[Sdf.Layer, str, str]] = []

    @property
    def losses(self) -> tuple[str, ...]:
        """A line for each thing that is missing, and for whatever else USD warned of."""
        return tuple(self._lines | self._warnings)

    def miss(self, line: str) -> None:
        """Notes that something is missing."""
        self._lines[line] = None

    @contextmanager
    def reading(self) -> Iterator[Usd.Stage]:
        """The composed stage, for the block that reads its values.

        Its files are held against the manifest before USD reads any.

        Raises:
            StageError: No file, not USD, not whole, or USD gives up on a value.
        """
        with native_reading(self._path), self._restoring():
            stage = self._open()
            with Tf.DiagnosticTrap() as trap:
                try:
                    yield stage
                except (Tf.ErrorException, UnicodeDecodeError) as error:
                    why = said(error) if isinstance(error, Tf.ErrorException) else error
                    raise StageError(f"{self._path}: cannot be read: {why}") from error
                except StageError as error:
                    if str(self._path) in str(error):
                        raise
                    raise StageError(f"{self._path}: {error}") from error
                finally:
                    for warning in trap.GetWarnings():
                        self._warnings[f"USD: {_plain(commentary(warning))}"] = None
                    trap.Clear()

    def _open(self) -> Usd.Stage:
        if not self._path.is_file():
            raise StageError(f"{self._path}: no such file")
        self._hold_against_manifest()
        self._require_complete()
        if damage := crate_fault(self._path):
            raise StageError(f"{self._path}: not a USD stage: {damage}")
        # Warnings about composition come again, as errors that can be told apart.
        with Tf.DiagnosticTrap() as trap:
            try:
                stage = Usd.Stage.Open(str(self._path))
            except Tf.ErrorException as error:
                raise _unreadable(self._path, error) from error
            finally:
                trap.Clear()
            self._read_materialx(stage)
            self._compose(stage)
            self._open_clips(stage)
            preview_networks(stage)
            trap.Clear()
        self._require_complete()
        return stage

    def _require_complete(self) -> None:
        """Ends the reading of a stage that lacks something, unless that is allowed."""
        lines = list(self._lines)
        if not lines or self._allowed:
            return
        more = f"; and {len(lines) - _MOST_LINES} more" if len(lines) > _MOST_LINES else ""
        raise StageError(
            f"{self._path}: is not whole: {'; '.join(lines[:_MOST_LINES])}{more}. Compile it again "
            "or put back what is missing; --allow-missing reads what is there"
        )

    def picture(self, attribute: Usd.Attribute, time: Usd.TimeCode = values.DEFAULT) -> Path | None:
        """The file that an asset attribute names; None where it names none, or is missing.

        Raises:
            StageError: It is no asset.
        """
        asset = values.asset(attribute, time)
        if asset is None:
            return None
        if is_tiled(asset.path):
            return self._tiles(attribute, asset.path, time)
        # Every mesh asks for the maps of its materials again.
        if asset.resolvedPath in self._pictures:
            return self._pictures[asset.resolvedPath]
        # Unresolved, it may be there by chance: relative to the working directory.
        if not os.path.isfile(_package(asset.resolvedPath)):
            self.miss(f"{attribute.GetPath()}: {asset.path} does not exist")
            return None
        file = self._pictures[asset.resolvedPath] = Path(asset.resolvedPath)
        self._beside.add(_package(asset.resolvedPath))
        return file

    def _tiles(self, attribute: Usd.Attribute, path: str, time: Usd.TimeCode) -> Path | None:
        """The path of UDIM tiles, of which at least one is there; relative to where it stands."""
        specs = attribute.GetPropertyStack(time)
        layer = next((spec.layer for spec in specs if spec.HasInfo("default")), specs[0].layer)
        file = Path(layer.ComputeAbsolutePath(path))
        if layer.realPath.lower().endswith(".usdz"):
            file = in_package(layer.realPath, path)
        tiles = tiles_of(file)
        if not tiles:
            self.miss(f"{attribute.GetPath()}: {path} has no tiles")
            return None
        self._beside.update(_package(str(tile)) for tile in tiles.values())
        return file

    def translated(self, material: UsdShade.Material) -> UsdShade.Material:
        """Returns the translation of a material of MDL's OmniPBR, or the material itself."""
        path = material.GetPath()
        if path not in self._translations:
            made = as_preview_surface(material, self._scratch)
            self._translations[path] = material if made is None else made
        return self._translations[path]

    def digest(self, stage: Usd.Stage) -> str:
        """sha256 over relative paths and bytes of all files that the stage was read from.

        A stage that lacks something has another digest than the whole one, so that what was
        rendered of it is never taken for a picture of that.

        Args:
            stage: As ``open`` returned it; its values have been read.

        Raises:
            StageError: Something is missing, or the manifest lists other files than these.
        """
        used = {_package(layer.realPath) for layer in stage.GetUsedLayers() if layer.realPath}
        for file in sorted((used | self._beside) - self._digests.keys()):
            self._digests[file] = _hash(file)
            if self._listed:
                self.miss(f"{self._named(file)}: is read, and is not in the {MANIFEST}")
        self._require_complete()
        pairs = [(self._named(file), digest) for file, digest in self._digests.items()]
        return digest_of_files([*pairs, *((_MISSING, line) for line in self._lines)])

    def _hold_against_manifest(self) -> None:
        listed = files_of_stage(self._path)
        self._listed = listed is not None
        for name, expected in (listed or {}).items():
            # Links may lead elsewhere, to the same bytes; names may not.
            file = os.path.normpath(os.path.join(self._folder, name))
            if not file.startswith(os.path.join(self._folder, "")):
                self.miss(f"{name}: the {MANIFEST} lists it, and it is not in the stage's folder")
            elif not os.path.isfile(file):
                self.miss(f"{name}: is in the {MANIFEST} and not on disk")
            else:
                self._digests[file] = _hash(file)
                if self._digests[file] != expected:
                    self.miss(f"{name}: its bytes are not those of the {MANIFEST}")

    def _named(self, file: str) -> str:
        """A file in messages and digests: relative to the stage's folder."""
        return os.path.relpath(_package(file), self._folder).replace(os.sep, "/")

    def _compose(self, stage: Usd.Stage) -> None:
        """Notes each file and prim that composition looked for in vain, however many look."""
        prims_of: dict[str, list[str]] = {}
        unread: set[str] = set()
        for error in stage.GetCompositionErrors():
            prim, text = str(error.rootSite.path), " ".join(str(error).split())
            if match := _SUBLAYER.search(text):
                file, layer, reason = match.groups()
                prim = self._named(layer)
                line = f"its sublayer {self._named(file)} {_state(file, reason)}"
            elif match := _ASSET.search(text):
                file, arc, layer, reason = match.groups()
                line = f"its {arc} to {self._named(file)} {_state(file, reason)}"
                if _is_materialx(file):
                    line = (
                        f"its {arc} to {self._named(file)}, MaterialX, is not read without the "
                        "extra materialx"
                    )
                    unread.add(line)
            elif match := _PRIM.search(text):
                arc, file, path, layer = match.groups()
                line = f"its {arc} to {self._named(file)} finds no prim {path} there"
            else:
                line = text
            prims_of.setdefault(line, []).append(prim)
        for line, prims in prims_of.items():
            more = f" (and so of {len(prims) - 1} more)" if len(prims) > 1 else ""
            if line in unread:
                self._warnings[f"{prims[0]}: {line}, displayColor is shown{more}"] = None
            else:
                self.miss(f"{prims[0]}: {line}{more}")

    def _read_materialx(self, stage: Usd.Stage) -> None:
        """Puts layers in memory in the place of ``.mtlx`` files, until the reading ends."""
        for layer in sorted(stage.GetUsedLayers(), key=lambda layer: str(layer.identifier)):
            for asset in layer.GetCompositionAssetDependencies():
                file = str(Ar.GetResolver().Resolve(layer.ComputeAbsolutePath(asset)))
                if not _is_materialx(file):
                    continue
                if file not in self._materialx:
                    self._materialx[file] = self._materials_of(file)
                made = self._materialx[file]
                if made is not None:
                    _replace(layer, asset, made.identifier)
                    self._replaced.append((layer, asset, made.identifier))

    @contextmanager
    def _restoring(self) -> Iterator[None]:
        """Has layers, which whoever else opens them shares, as they were before."""
        try:
            yield
        finally:
            with Tf.DiagnosticTrap() as trap:
                for layer, asset, made in self._replaced:
                    _replace(layer, made, asset)
                trap.Clear()

    def _materials_of(self, file: str) -> Sdf.Layer | None:
        try:
            found = materialx_layer(file, self._named(file))
        except StageError as error:
            self.miss(str(error))
            found = Sdf.Layer.CreateAnonymous(".usda")
        if found is not None:
            self._beside.add(_package(file))
        return found

    def _open_clips(self, stage: Usd.Stage) -> None:
        """Opens the layers of value clips, which USD would do, or not, when a value is read."""
        for prim in stage.TraverseAll():
            if not prim.HasMetadata("clips"):
                continue
            api = Usd.ClipsAPI(prim)
            for name in api.GetClips():
                assets = [*(api.GetClipAssetPaths(name) or ()), api.GetClipManifestAssetPath(name)]
                for asset in assets:
                    if asset is None or not asset.path:
                        continue
                    told = f"{prim.GetPath()}: its value clip {asset.path}"
                    if not asset.resolvedPath:
                        self.miss(f"{told} does not exist")
                        continue
                    self._beside.add(_package(asset.resolvedPath))
                    try:
                        Sdf.Layer.FindOrOpen(asset.resolvedPath)
                    except Tf.ErrorException as error:
                        self.miss(f"{told} cannot be read: {said(error)}")


def open_stage(path: Path) -> AbstractContextManager[Usd.Stage]:
    """A composed stage of which every layer is there, and as its manifest has it, for a block.

    Raises:
        StageError: No file, not USD, not whole, or USD gives up on a value.
    """
    return Sources(path).reading()


def _unreadable(path: Path, error: Tf.ErrorException) -> StageError:
    reason = said(error)
    # The parser says where in the file: that belongs behind the file's name.
    match = re.match(rf"(?:{re.escape(os.path.abspath(path))}|{re.escape(str(path))})(:\d+:\d+): ",
                     reason)  # fmt: skip
    place = match[1] if match else ""
    return StageError(
        f"{path}{place}: not a USD stage: {reason[match.end() :] if match else reason}"
    )


def _hash(file: str) -> str:
    try:
        return sha256(Path(file))
    except OSError as error:
        raise StageError(f"{file}: cannot be read: {error.strerror}") from error


def _plain(text: str) -> str:
    """Returns USD's message in one line, without the addresses that it adds."""
    return " ".join(re.sub(r"\(?\b[\w ]*@[^@]*@ <0x[0-9a-f]+>\)?", "", text).split())


def _state(file: str, reason: str | None) -> str:
    """Why a file that is named was not read."""
    if os.path.isfile(_package(file)):
        return f"cannot be read: {_located(reason or 'it is no USD')}"
    return "does not exist"


def _is_materialx(file: str) -> bool:
    """Tells whether a file is there that usd-core, without MaterialX's plug-in, cannot read."""
    file = file.partition(":SDF_FORMAT_ARGS:")[0]
    return file.rstrip("]").lower().endswith(".mtlx") and os.path.isfile(_package(file))


def _replace(layer: Sdf.Layer, old: str, new: str) -> None:
    """Has a layer refer to another one; a layer of a package, too, which is never written."""
    permitted = layer.permissionToEdit
    layer.SetPermissionToEdit(True)
    layer.UpdateCompositionAssetDependency(old, new)
    layer.SetPermissionToEdit(permitted)


def _located(reason: str) -> str:
    """Returns the part of USD's message, divided by semicolons, that names a line of the file."""
    parts = [part.strip() for part in reason.split(" ; ")]
    return next((part for part in parts if re.search(r":\d+:\d+: ", part)), parts[0])


def _package(file: str) -> str:
    """The file that a layer lies in: itself, or the package around it."""
    return os.path.abspath(Ar.SplitPackageRelativePathOuter(file)[0])
