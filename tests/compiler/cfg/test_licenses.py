"""Under which terms inputs may be used is taken from where it is said, and nowhere else."""

from __future__ import annotations

import importlib.metadata
import importlib.util
import json
import struct
from pathlib import Path

import pytest

from scenec.compiler.cfg.licenses import License, as_json, terms
from scenec.compiler.compile import compile_cfg
from scenec.compiler.kinds.context import InputFile
from scenec.schemas.manifest import read_manifest, stage_digest
from scenec.testing.small import small_cfg, write_cfg

ROOT = Path(__file__).resolve().parents[3]
BESIDE = """\
SPDX-FileCopyrightText: 2020 Ada <ada@example.org>
SPDX-FileCopyrightText: 2021 Grace

SPDX-License-Identifier: CC-BY-4.0
"""


def terms_of(path: Path, reference: str | None = None) -> License:
    return terms(InputFile(path, "0" * 64, path.name if reference is None else reference))


def test_a_license_file_beside_it_says_it(tmp_path: Path) -> None:
    path = tmp_path / "dem.npy"
    path.touch()
    (tmp_path / "dem.npy.license").write_text(BESIDE, encoding="utf-8")
    assert terms_of(path) == License(
        "CC-BY-4.0", ("2020 Ada <ada@example.org>", "2021 Grace"), "dem.npy.license beside it"
    )


REUSE = """
version = 1
[[annotations]]
path = "**"
SPDX-FileCopyrightText = "everyone"
SPDX-License-Identifier = "CC0-1.0"
[[annotations]]
path = ["rocks/*.glb", "one[1].csv"]
SPDX-FileCopyrightText = ["2022 B", "2023 C"]
SPDX-License-Identifier = ["MIT", "Apache-2.0"]
"""


@pytest.mark.parametrize(
    ("name", "license_"),
    [
        ("rocks/flint.glb", "MIT AND Apache-2.0"),
        ("one[1].csv", "MIT AND Apache-2.0"),
        ("one1.csv", "CC0-1.0"),
        ("rocks/deep/flint.glb", "CC0-1.0"),
    ],
)
def test_the_last_annotation_of_a_reuse_file_above_that_fits_counts(
    name: str, license_: str, tmp_path: Path
) -> None:
    (tmp_path / "REUSE.toml").write_text(REUSE, encoding="utf-8")
    path = tmp_path / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.touch()
    found = terms_of(path)
    assert (found.license, found.source) == (license_, "REUSE.toml")


def test_nothing_above_a_checkout_is_asked(tmp_path: Path) -> None:
    (tmp_path / "REUSE.toml").write_text(REUSE, encoding="utf-8")
    (tmp_path / "checkout" / ".git").mkdir(parents=True)
    path = tmp_path / "checkout" / "a.csv"
    path.touch()
    assert terms_of(path) == License()
    (tmp_path / "checkout" / "REUSE.toml").write_text("this is no TOML [", encoding="utf-8")
    assert terms_of(path) == License()


@pytest.mark.parametrize("name", ["numpy", "scipy"])
def test_a_file_of_a_package_has_the_package_s_terms(name: str) -> None:
    """NumPy's metadata have an expression, SciPy's the whole text and a classifier."""
    spec = importlib.util.find_spec(name)
    assert spec.origin is not None
    found = terms_of(Path(spec.origin).parent / "version.py", f"package:{name}/version.py")
    metadata = importlib.metadata.metadata(name)
    assert found.source == f"metadata of the package {name}"
    assert found.license is not None
    if metadata.get("License-Expression"):
        assert metadata["License-Expression"].startswith(found.license)
    else:
        assert f"License :: OSI Approved :: {found.license}" in metadata.get_all("Classifier", [])


def test_a_text_in_a_package_s_folder_goes_before_the_package(tmp_path: Path) -> None:
    folder = tmp_path / "numpy" / "skies"
    folder.mkdir(parents=True)
    (folder / "city.exr").touch()
    (folder / "license.txt").write_text("\nAll are CC0.\nBy somebody.\n", encoding="utf-8")
    found = terms_of(folder / "city.exr", "package:numpy/skies/city.exr")
    assert found == License("All are CC0.", (), "license.txt beside it")


@pytest.mark.parametrize("suffix", [".glb", ".gltf"])
def test_a_gltf_file_says_whose_it_is(suffix: str, tmp_path: Path) -> None:
    text = json.dumps({"asset": {"version": "2.0", "copyright": "2019 Smith"}}).encode()
    head = struct.pack("<4sIII4s", b"glTF", 2, 20 + len(text), len(text), b"JSON")
    path = tmp_path / f"rock{suffix}"
    path.write_bytes(head + text if suffix == ".glb" else text)
    assert terms_of(path) == License(None, ("2019 Smith",), "asset.copyright in the file")
    path.write_bytes(path.read_bytes()[:25])
    assert terms_of(path) == License()


def test_a_folder_has_the_terms_that_its_files_share(tmp_path: Path) -> None:
    folder = tmp_path / "bark"
    folder.mkdir()
    for name in ("color.png", "normal.png"):
        (folder / name).touch()
    (tmp_path / "REUSE.toml").write_text(REUSE, encoding="utf-8")
    assert terms_of(folder).license == "CC0-1.0"
    (folder / "normal.png.license").write_text(BESIDE, encoding="utf-8")
    assert terms_of(folder) == License()


def test_no_path_of_a_machine_goes_into_the_manifest(tmp_path: Path) -> None:
    path = tmp_path / "dem.npy"
    path.touch()
    assert as_json(InputFile(path, "0" * 64, str(path)))["file"] == "dem.npy"
    assert as_json(InputFile(path, "0" * 64, "../x/dem.npy"))["file"] == "../x/dem.npy"


@pytest.mark.parametrize("path", sorted((ROOT / "assets").rglob("*.*")), ids=lambda p: p.name)
def test_every_file_of_ours_says_its_terms(path: Path) -> None:
    if path.suffix in (".md", ".toml"):
        return
    license_ = "CC0-1.0" if path.suffix in (".glb", ".tif") else "Apache-2.0"
    assert terms_of(path) == License(license_, ("The scenec authors",), "REUSE.toml")


def test_the_manifest_holds_terms_and_the_cfg_s_own_bytes(tmp_path: Path) -> None:
    cfg = small_cfg(samples=1)
    cfg["objects"]["rocks"]["count"] = 3
    birds = {
        "type": "placed",
        "models": [{"file": "bird.glb"}],
        "labels": {"class": "rock", "surface": "stone"},
        "poses": [{"x_m": 0, "y_m": 0}],
    }
    cfg["objects"]["birds"] = birds
    (tmp_path / "bird.glb").write_bytes((ROOT / "assets/models/lander.glb").read_bytes())
    path = write_cfg(tmp_path, cfg)
    compile_cfg(path, seed=1, out=tmp_path / "out")
    before = read_manifest(tmp_path / "out")
    pointer = "objects/birds/models/0/file"
    assert before.cfg.licenses[pointer] == {
        "file": "bird.glb", "license": None, "copyright": ["The scenec authors, CC0-1.0"],
        "source": "asset.copyright in the file",
    }  # fmt: skip
    assert set(before.cfg.inputs) == set(before.cfg.licenses)
    assert (tmp_path / "out/cfg.json").read_bytes() == path.read_bytes()
    assert before.files["cfg.json"].bytes == path.stat().st_size
    assert not [name for name in before.files if name.startswith("batch") and "cfg" in name]

    # Terms found later, and another layout, change the manifest but no batch.
    (tmp_path / "bird.glb.license").write_text(BESIDE, encoding="utf-8")
    path.write_text(json.dumps(cfg), encoding="utf-8")
    assert compile_cfg(path, seed=1, out=tmp_path / "out").unchanged == 1
    after = read_manifest(tmp_path / "out")
    assert after.cfg.licenses[pointer]["license"] == "CC-BY-4.0"
    assert stage_digest(after, "batch_0000") == stage_digest(before, "batch_0000")
    assert (tmp_path / "out/cfg.json").read_bytes() == path.read_bytes()
