"""Renders a stage with Hydra Storm out of bpy's bundled USD, without a window.

Runs in a process of its own, where usd-core is never loaded: ``storm_render.py JOB.json``. The job
holds ``stage``, ``session`` (text of the session layer), ``mute`` (layers to leave out), perhaps
``complexity`` (above 1 surfaces are refined), and ``shots``: (camera, time code, width, picture to
write). Exits with NO_EGL where there is no EGL.
"""

import json
import os
import sys
from pathlib import Path

NO_EGL = 77

# One sample at the center of each pixel; Mesa refuses some of Storm's calls that do no harm.
os.environ |= {"HDX_MSAA_SAMPLE_COUNT": "1", "MESA_NO_ERROR": "1"}


def main():
    """Renders all shots."""
    job = json.loads(Path(sys.argv[1]).read_text(encoding="utf-8"))
    import bpy
    import moderngl

    try:
        context = moderngl.create_context(standalone=True, require=450, backend="egl")
    except Exception as error:  # noqa: BLE001 - whatever EGL lacks here
        print(f"no OpenGL 4.5 by EGL: {error}")
        sys.exit(NO_EGL)
    bpy.utils.expose_bundled_modules()
    from pxr import Sdf, Usd, UsdAppUtils, UsdGeom

    context.simple_framebuffer((8, 8)).use()
    session = Sdf.Layer.CreateAnonymous(".usda")
    session.ImportFromString(job["session"])
    stage = Usd.Stage.Open(Sdf.Layer.FindOrOpen(job["stage"]), session)
    stage.MuteAndUnmuteLayers(job["mute"], [])
    recorder = UsdAppUtils.FrameRecorder("HdStormRendererPlugin", True)
    recorder.SetColorCorrectionMode("disabled")
    recorder.SetCameraLightEnabled(False)
    recorder.SetComplexity(job.get("complexity", 1.0))
    for camera, time, width, picture in job["shots"]:
        recorder.SetImageWidth(width)
        recorder.Record(stage, UsdGeom.Camera(stage.GetPrimAtPath(camera)), time, picture)


if __name__ == "__main__":
    main()
