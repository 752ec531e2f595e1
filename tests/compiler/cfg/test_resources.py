"""Files in installed packages."""

from __future__ import annotations

import sys

import pytest

from scenec.compiler.cfg.resources import ResourceError, find_file


@pytest.fixture
def package(tmp_path, monkeypatch):
    folder = tmp_path / "site" / "oddly_named_package"
    (folder / "data" / "1.2").mkdir(parents=True)
    (folder / "__init__.py").write_text("raise RuntimeError('imported')")
    for name in ("moon.npz", "mars.npz"):
        (folder / "data" / "1.2" / name).write_bytes(b"")
    monkeypatch.syspath_prepend(str(tmp_path / "site"))
    return folder


def test_a_file_is_found_in_a_package_that_is_not_imported(package, tmp_path):
    found = find_file("package:oddly_named_package/data/*/moon.npz", tmp_path)
    assert found == package / "data" / "1.2" / "moon.npz"
    assert "oddly_named_package" not in sys.modules


@pytest.mark.parametrize(
    ("reference", "part"),
    [
        ("package:oddly_named_package/data/*/*.npz", "matches 2 files, expected exactly one"),
        ("package:oddly_named_package/data/*/earth.npz", "no file"),
        ("package:oddly_named_package/data", "no file"),
        ("package:oddly_named_package", 'expected "package:NAME/path'),
        ("package:oddly_named_package/", 'expected "package:NAME/path'),
        ("package:oddly.named/x", 'expected "package:NAME/path'),
        ("package:oddly_named_package/../x", "plain path below"),
        ("package:oddly_named_package//x", "plain path below"),
        ("package:no_such_package_here/x", "pip install no_such_package_here"),
        ("package:sys/x", "not installed"),
        ("x" * 5000, "too long"),
        (".", "is a folder"),
    ],
)
def test_what_is_not_one_file_is_refused_with_what_would_help(package, tmp_path, reference, part):
    with pytest.raises(ResourceError) as caught:
        find_file(reference, tmp_path)
    assert part in str(caught.value)


def test_a_package_that_an_extra_brings_is_named_with_the_extra(tmp_path, monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(ResourceError, match=r"pip install 'scenec\[geotiff\]'"):
        find_file("package:rasterio/x.tif", tmp_path)


def test_a_plain_path_is_relative_to_the_cfg_and_may_be_absolute(tmp_path):
    (tmp_path / "dem.npz").write_bytes(b"")
    assert find_file("dem.npz", tmp_path) == tmp_path / "dem.npz"
    assert find_file(str(tmp_path / "dem.npz"), tmp_path / "elsewhere") == tmp_path / "dem.npz"
