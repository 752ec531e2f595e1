"""What the repository's files must not hold, and what its lock files must."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterable, Iterator, Mapping
from importlib.metadata import distribution
from pathlib import Path

import pytest

from scenec.testing.processes import ran

ROOT = Path(__file__).resolve().parents[2]
#: Folders of one machine; a letter or a dot before the slash makes it a relative path.
MACHINE_PATH = re.compile(r"(?<![\w.])/(?:work|root|home/[a-z]\w*|Users/[A-Za-z]\w*)/")
REGISTRY_HOST = re.compile(r"\b(?:pypi|pythonhosted|crates|npmjs|anaconda)\.(?:org|io)\b", re.I)
ADDRESS = re.compile(r"\w+://|^\s*(?:--(?:extra-)?index-url|--find-links|-[if])\b", re.M)
LOCKS_WITH_ADDRESSES = re.compile(r"(?:^|/)(?:uv|pylock|poetry|pdm)[^/]*\.(?:lock|toml)$")


def repository_files() -> list[Path]:
    """Files that are tracked, or would be if added; in the order of git."""
    done = ran("git", "ls-files", "-z", "--cached", "--others", "--exclude-standard", cwd=ROOT)
    if done.returncode != 0:
        pytest.fail(f"not a git checkout: {done.stderr.strip()}")
    names = [ROOT / name for name in done.stdout.split("\0") if name]
    return [path for path in names if path.is_file()]


def texts() -> list[tuple[str, str]]:
    """Name and text of every repository file that is text."""
    found = []
    for path in repository_files():
        data = path.read_bytes()
        if b"\0" not in data[:4096]:
            found.append((str(path.relative_to(ROOT)), data.decode("utf-8")))
    return found


def test_the_patterns_know_a_machine_path_and_a_host():
    slash, dot = "/", "."
    assert MACHINE_PATH.search(f'open("{slash}home/ada/scenes")')
    assert MACHINE_PATH.search(f"{slash}work{slash}main")
    assert not MACHINE_PATH.search(f"out{slash}work{slash}main")
    assert REGISTRY_HOST.search(f"files{dot}pythonhosted{dot}org")
    assert ADDRESS.search("--index-url anything")
    assert ADDRESS.search("a @ https:" + "//host/a.whl")
    assert not ADDRESS.search("numba==0.68.1 \\\n    --hash=sha256:00\n    # via scenec")
    assert LOCKS_WITH_ADDRESSES.search("docs/uv.lock")


def test_no_file_holds_a_path_of_one_machine():
    found = [name for name, text in texts() if MACHINE_PATH.search(text)]
    assert not found


def test_no_file_names_a_registry_host():
    found = [name for name, text in texts() if REGISTRY_HOST.search(text)]
    assert not found


#: What is installed as pip does it, and what with ``--no-deps``.
LOCK, NODEPS = "requirements.lock", "requirements-nodeps.lock"


def test_no_lock_file_with_addresses_is_in_the_repository():
    names = [name for name, _ in texts()]
    assert {LOCK, NODEPS} <= set(names)
    assert not [name for name in names if LOCKS_WITH_ADDRESSES.search(name)]
    assert not any(ADDRESS.search((ROOT / name).read_text()) for name in (LOCK, NODEPS))


#: Extras that are in neither the lock nor the extra "all".
TOO_LARGE = ("torch", "networks", "rerun")
#: Extras that build the pages and run the lab: in the lock, of no use to who makes pictures.
FOR_DEVELOPERS = ("docs", "lab")


def entries(*files: str) -> list[str]:
    """Version, marker and hashes of each locked package, for all Pythons."""
    text = "".join((ROOT / name).read_text() for name in files or (LOCK, NODEPS))
    lines = text.replace("\\\n", " ").splitlines()
    return [line for line in lines if line and not line.lstrip().startswith("#")]


def locked(*files: str) -> dict[str, str]:
    """Normalized name to the entry of each package that is locked for this Python."""
    from packaging.requirements import Requirement

    parsed = ((Requirement(entry.partition("--hash")[0]), entry) for entry in entries(*files))
    return {
        asked.name: entry for asked, entry in parsed if not asked.marker or asked.marker.evaluate()
    }


def test_every_locked_package_has_a_version_and_a_hash():
    assert len(entries()) > 20
    for entry in entries():
        assert re.match(r"[a-z0-9-]+==\S+ ", entry), entry
        assert re.search(r"--hash=sha256:[0-9a-f]{64}\b", entry), entry


def test_the_lock_holds_every_declared_dependency_at_an_allowed_version():
    from packaging.requirements import Requirement
    from packaging.utils import canonicalize_name

    table = tomllib.loads((ROOT / "pyproject.toml").read_text())
    declared = list(table["project"]["dependencies"]) + list(table["dependency-groups"]["dev"])
    for name, extra in table["project"]["optional-dependencies"].items():
        declared += [] if name in TOO_LARGE else extra
    here = locked()
    requirements = [Requirement(text) for text in declared]
    for requirement in requirements:
        if requirement.name == "scenec" or not (
            requirement.marker is None or requirement.marker.evaluate()
        ):
            continue
        version = here[canonicalize_name(requirement.name)].split("==")[1].split()[0]
        assert requirement.specifier.contains(version), (requirement, version)


def unmet(wanted: Mapping[str, Iterable[str]], held: Mapping[str, str]) -> Iterator[str]:
    """What locked packages need here that is not locked, or at a version that they do not take.

    Args:
        wanted: Package to the extras asked of it.
        held: Package to its locked version.
    """
    from packaging.requirements import Requirement
    from packaging.utils import canonicalize_name

    waiting = [(name, extra) for name, extras in wanted.items() for extra in ("", *extras)]
    done = set()
    while waiting:
        name, extra = waiting.pop()
        if (name, extra) in done:
            continue
        done.add((name, extra))
        for requirement in map(Requirement, distribution(name).requires or []):
            if requirement.marker and not requirement.marker.evaluate({"extra": extra}):
                continue
            needed = canonicalize_name(requirement.name)
            if needed not in held or not requirement.specifier.contains(held[needed], True):
                yield f"{name} needs {requirement}"
            else:
                waiting += [(needed, also) for also in ("", *requirement.extras)]


def versions(*files: str) -> dict[str, str]:
    return {name: entry.split("==")[1].split()[0] for name, entry in locked(*files).items()}


def test_pip_finds_all_that_locked_packages_need_in_the_lock():
    held = versions(LOCK)
    assert not list(unmet(dict.fromkeys(held, ()), held))


def test_only_overridden_needs_of_the_packages_without_dependencies_are_not_locked():
    uv = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["uv"]
    overridden = {text.split(";")[0] for text in uv["override-dependencies"]}
    replaced = {one["name"]: set(one["requires-dist"]) for one in uv["dependency-metadata"]}
    held = versions()
    apart = versions(NODEPS)
    for name, needs in replaced.items():
        assert apart.pop(name)
        assert needs <= held.keys()
    missing = {text.split(" needs ")[1] for text in unmet(dict.fromkeys(apart, ()), held)}
    assert {name.replace("_", "-") for name in missing} == overridden


def test_a_package_taken_out_of_the_lock_is_missed():
    held = versions(LOCK)
    del held["llvmlite"]
    assert [text.split()[0] for text in unmet({"numba": ()}, held)] == ["numba"]


def test_the_extra_all_is_all_extras_that_users_want_but_what_is_too_large():
    table = tomllib.loads((ROOT / "pyproject.toml").read_text())
    extras = table["project"]["optional-dependencies"]
    inside = [name for name in extras if name not in ("all", *TOO_LARGE, *FOR_DEVELOPERS)]
    assert extras["all"] == [f"scenec[{','.join(inside)}]"]


def test_the_source_links_are_relative_and_complete():
    inside = [p for p in (ROOT / "src" / "scenec").iterdir() if p.name != "__pycache__"]
    files = {path.name for path in inside if not path.is_symlink()}
    assert files == {"__init__.py", "torch.py"}
    links = {path.name: path.readlink() for path in inside if path.is_symlink()}
    expected = ("schemas", "compiler", "backends", "datasets", "quality", "settle", "importers",
                "api", "cli", "testing", "lab", "assets", "configs")  # fmt: skip
    assert links == {name: Path("../..") / name for name in expected}
