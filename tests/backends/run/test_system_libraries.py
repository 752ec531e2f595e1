"""Machines without X11, OpenGL or EGL: what works there, and what is said of what does not.

Libraries are hidden by an overlay in a mount namespace, which takes Linux and root's powers.
"""

from __future__ import annotations

import ctypes.util
import importlib.util
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from scenec.backends.pyrender import platforms
from scenec.schemas import system_libraries

HIDES = """
for folder in /usr/lib/x86_64-linux-gnu /usr/lib64; do
  [ -d $folder ] || continue
  place=$(mktemp -d); mount -t tmpfs tmpfs $place || exit 99; mkdir $place/up $place/work
  for name in $LIBRARIES; do for file in $folder/$name*; do
    mknod $place/up/$(basename $file) c 0 0 || exit 99
  done; done
  layers=lowerdir=$folder,upperdir=$place/up,workdir=$place/work
  mount -t overlay overlay -o $layers $folder || exit 99
done
exec "$@"
"""
PROBES = """
import sys
from scenec.backends.run.doctor import probe
from scenec.schemas.errors import BackendError
try:
    print(probe(sys.argv[1]).version)
except BackendError as error:
    print(error)
"""


def without(libraries: str, *command: str) -> str:
    """What a command prints where some of the system's libraries are hidden."""
    words = ["unshare", "--mount", "sh", "-c", HIDES, "sh", *command]
    try:
        done = subprocess.run(
            words, env={"LIBRARIES": libraries, "PATH": "/usr/bin:/bin"}, text=True,
            capture_output=True, check=False,
        )  # fmt: skip
    except FileNotFoundError:
        pytest.skip("there is no unshare")
    if done.returncode == 99 or "unshare" in done.stderr:
        pytest.skip(f"libraries cannot be hidden here: {done.stderr.strip()}")
    assert "Traceback" not in done.stderr, done.stderr
    return done.stdout


@pytest.mark.slow
@pytest.mark.parametrize(
    ("hidden", "platform"),
    [
        ("libXrender. libXi. libXt. libSM. libICE.", "egl"),
        ("libGL.", "egl"),
        ("libOpenGL.", "egl"),
        ("libX libEGL. libGL. libOpenGL.", "osmesa"),
    ],
)
def test_pyrender_draws_without_x11_and_without_a_libgl(hidden, platform):
    if platform == "osmesa" and not platforms.wheel_libraries():
        pytest.skip("lavavu-osmesa is not installed")
    if platform == "egl" and ctypes.util.find_library("EGL") is None:
        pytest.skip("there is no EGL")
    said = without(hidden, sys.executable, "-c", PROBES, "pyrender")
    assert re.match(rf"pyrender [\d.]+ {platform} ", said), said


@pytest.mark.slow
@pytest.mark.parametrize(
    ("hidden", "packages"),
    [
        ("libXrender.", ["libxrender1"]),
        ("libSM. libXi. libxkbcommon.", ["libxi6", "libsm6", "libxkbcommon0"]),
        ("libGL.", ["libgl1"]),
    ],
)
def test_what_blender_lacks_of_the_system_is_named_with_its_packages(hidden, packages):
    if importlib.util.find_spec("bpy") is None:
        pytest.skip("there is no bpy")
    said = without(hidden, sys.executable, "-c", PROBES, "cycles")
    (line,) = said.splitlines()
    assert line.startswith("Blender cannot be imported: the system lacks lib")
    # What is hidden may be needed by what is named, too.
    assert set(packages) <= set(re.search(r"apt install ([\w .-]+) \(", line)[1].split())
    assert "pip install" not in line


@pytest.mark.slow
def test_what_mitsuba_lacks_of_the_system_is_named_with_its_packages():
    said = without("libatomic.", sys.executable, "-c", PROBES, "mitsuba")
    assert said.splitlines() == [
        "Mitsuba cannot be imported: the system lacks libatomic.so.1; mend it with: apt install "
        "libatomic1 (Debian, Ubuntu), or dnf install libatomic (Fedora)"
    ]


@pytest.mark.slow
def test_a_blend_file_where_blender_lacks_a_library_is_a_fault_that_names_it(tmp_path):
    if importlib.util.find_spec("bpy") is None:
        pytest.skip("there is no bpy")
    file = tmp_path / "a.blend"
    file.write_bytes(b"BLENDER17-01v0502")
    code = "import sys; from pathlib import Path; from scenec.compiler.assets import blend, parts\n"
    code += "try: blend.read_blend(Path(sys.argv[1]), True)\n"
    code += "except parts.MeshFileError as error: print(error)"
    said = without("libXrender.", sys.executable, "-c", code, str(file))
    assert "it takes Blender to read: the system lacks libXrender.so.1" in said


def test_of_a_library_that_is_there_nothing_is_missing():
    name = ctypes.util.find_library("c")
    assert system_libraries.missing([name]) == ()
    assert system_libraries.missing([name, "libXrender.so.99"]) == ("libXrender.so.99",)
    said = system_libraries.mend(["libXi.so.6", "libGL.so.1"])
    assert "libXi.so.6, libGL.so.1" in said
    assert "apt install libxi6 libgl1" in said


def needed_beside(package: str, *patterns: str) -> set[str]:
    """Libraries that the files of a wheel need and it does not bring, by the files' own tables."""
    spec = importlib.util.find_spec(package)
    if spec is None or shutil.which("readelf") is None:
        pytest.skip(f"there is no {package}, or no readelf")
    files = [file for pattern in patterns for file in Path(spec.origin).parent.glob(pattern)]
    listed = subprocess.run(
        ["readelf", "--dynamic", *files], capture_output=True, text=True, check=False
    )
    return set(re.findall(r"NEEDED.*\[(.+)\]", listed.stdout)) - {file.name for file in files}


def test_every_library_that_blender_s_wheel_needs_is_known():
    needed = needed_beside("bpy", "__init__.so", "lib/*.so*")
    graphic = {name for name in needed if re.match(r"lib(X|SM|ICE|GL|xkb|EGL)", name)}
    assert graphic == set(system_libraries.OF_BLENDER)


@pytest.mark.parametrize("package", ["drjit", "mitsuba"])
def test_every_library_that_mitsuba_s_wheels_need_is_known(package):
    # The C and C++ libraries are everywhere.
    base = re.compile(r"(libc|libm|libdl|librt|libpthread|libgcc_s|libstdc\+\+|ld-linux.*)\.so")
    needed = {n for n in needed_beside(package, "*.so*", "plugins/*.so") if not base.match(n)}
    ours = re.compile(r"lib(drjit|mitsuba|nanothread)")
    assert {n for n in needed if not ours.match(n)} <= set(system_libraries.OF_MITSUBA)
