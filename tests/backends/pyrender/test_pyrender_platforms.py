"""Where pyrender runs: EGL or OSMesa, software or a GPU."""

from __future__ import annotations

import json
import os
import subprocess
import sys

import numpy as np
import pytest

from scenec.backends.pyrender import Pyrender, egl, platforms
from scenec.backends.testing import geometry


def elsewhere(code: str, platform: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", code, *arguments],
        env={**os.environ, platforms.PLATFORM_VARIABLE: platform},
        capture_output=True,
        text=True,
        check=False,
    )


OTHER_PLATFORM = """
import json
import numpy as np
import pytest
from scenec.backends.pyrender import Pyrender
from scenec.backends.testing import Conformance, geometry
class Here(Conformance):
    backend = Pyrender
Here.setup_class()
check = Here()
for name in ("field", "one mesh of many faces", "through the camera's plane"):
    check.test_witness(name)
light = check.draw(geometry.busy(), 0, 9).halves[0].astype(float)
print(json.dumps([Pyrender().version(), light.tolist()]))
"""


@pytest.mark.slow
def test_it_is_the_same_through_osmesa():
    if not platforms.wheel_libraries():
        pytest.skip("lavavu-osmesa is not installed")
    done = elsewhere(OTHER_PLATFORM, "osmesa")
    assert done.returncode == 0, done.stderr
    version, light = json.loads(done.stdout.splitlines()[-1])
    assert "osmesa" in version
    backend = Pyrender()
    made = geometry.busy()
    backend.load(made)
    ours = backend.radiance(made.cameras[0][0], 0, 9, 1).halves[0].astype(float)
    theirs = np.array(light)
    # Rounding may turn a sample over at an edge or a shadow's rim.
    assert np.mean(np.abs(theirs - ours) > 0.01 * ours + 1e-6) < 0.02
    assert theirs.mean() == pytest.approx(ours.mean(), rel=2e-3)


CUDA = egl.EglDevice(0, True, False)
SOFTWARE = egl.EglDevice(1, False, True)
OTHER = egl.EglDevice(2, False, False)


@pytest.mark.parametrize(
    ("devices", "wanted", "index"),
    [
        ([SOFTWARE, CUDA], "auto", 0),
        ([OTHER, SOFTWARE], "auto", 1),
        ([OTHER], "auto", 2),
        ([OTHER, CUDA, SOFTWARE], "cpu", 1),
        ([OTHER, SOFTWARE, CUDA], "cuda", 0),
    ],
)
def test_the_device_is_a_gpu_of_nvidia_or_else_software(devices, wanted, index):
    assert platforms.choose(devices, wanted).index == index


SAYS = """
import sys
from scenec.backends.pyrender import Pyrender, egl, platforms
from scenec.schemas.errors import BackendError
if "none" in sys.argv:
    def missing(*names):
        raise OSError(f"{names[0]} is missing")
    egl.library, platforms.wheel_libraries = missing, lambda: []
    platforms.library = missing
try:
    print(Pyrender(sys.argv[1]).version())
except BackendError as error:
    print(error)
"""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("platform", "device", "extra", "words"),
    [
        ("glx", "auto", "", ["SCENEC_PYRENDER_PLATFORM", "'glx'", "egl or osmesa"]),
        ("", "auto", "none", ["libEGL", "libOSMesa", "pip install 'scenec[osmesa]'"]),
        ("osmesa", "cuda", "", ["no NVIDIA GPU", "--device cpu"]),
    ],
)
def test_what_does_not_work_is_said_in_one_line(platform, device, extra, words):
    done = elsewhere(SAYS, platform, device, extra)
    assert len(done.stdout.splitlines()) == 1, done.stderr
    assert all(word in done.stdout for word in words), done.stdout
    # Nothing is left to complain about at the end either.
    assert "Traceback" not in done.stderr


@pytest.mark.slow
def test_where_egl_is_missing_osmesa_takes_its_place():
    if not platforms.wheel_libraries():
        pytest.skip("lavavu-osmesa is not installed")
    code = SAYS.replace('if "none" in sys.argv:', "if True:").replace(
        ", platforms.wheel_libraries = missing, lambda: []", " = missing"
    )
    done = elsewhere(code, "", "auto")
    assert " osmesa " in done.stdout, done.stdout + done.stderr
    assert done.stderr == ""
