"""One picture by Cycles: its settings, and the way of its pixels out of Blender."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenec.backends.cycles.blender import passing_file, quiet
from scenec.schemas.budget import thread_budget
from scenec.schemas.errors import BackendError

COMBINED, NOISY = "Combined", "Noisy Image"

_LAYER = "scenec"


def set_up(scene: Any, device: str, bounces: int) -> None:
    """Settings that hold for all pictures of a Blender scene.

    Args:
        scene: Blender's scene.
        device: "cpu", or a GPU's name.
        bounces: See ``contract.BOUNCES``.
    """
    render, cycles = scene.render, scene.cycles
    render.engine = "CYCLES"
    scene.view_layers[0].name = _LAYER
    # Geometry, hierarchies and shaders stay in Cycles from one picture to the next. (With a second
    # Blender scene for visibility, either would push the other out.)
    render.use_persistent_data = True
    render.use_compositing = render.use_sequencer = False
    if thread_budget() is not None:
        render.threads_mode, render.threads = "FIXED", thread_budget()
    render.use_motion_blur = render.use_simplify = render.use_border = False
    render.use_texture_cache = False
    render.resolution_percentage = 100
    render.film_transparent = True
    # Linear light as it is: no view transform, no exposure, no dither.
    render.dither_intensity = 0.0
    scene.view_settings.view_transform = "Raw"
    scene.view_settings.exposure, scene.view_settings.gamma = 0.0, 1.0
    render.use_file_extension = False
    image = render.image_settings
    image.media_type = "MULTI_LAYER_IMAGE"
    image.file_format = "OPEN_EXR_MULTILAYER"
    image.color_depth, image.exr_codec = "32", "NONE"
    cycles.device = "CPU" if device == "cpu" else "GPU"
    cycles.use_auto_tile = False
    cycles.film_exposure = 1.0
    cycles.use_adaptive_sampling = False
    # Every pixel and every seed has a sequence of its own, so that halves are independent. The
    # blue-noise patterns, no less exact, share one sequence among all pixels of both.
    cycles.sampling_pattern = "TABULATED_SOBOL"
    cycles.use_animated_seed = False
    cycles.diffuse_bounces = cycles.glossy_bounces = bounces
    cycles.transmission_bounces = bounces
    # Nothing is transparent but gobos, which shadow rays go through, and cut-outs (``Built``).
    cycles.transparent_max_bounces = bounces + 1
    # No Russian roulette before paths end anyway: it adds noise, saves little.
    cycles.min_light_bounces = bounces
    cycles.light_sampling_threshold = 0.0
    cycles.sample_clamp_direct = cycles.sample_clamp_indirect = 0.0
    cycles.blur_glossy = 0.0
    cycles.caustics_reflective = cycles.caustics_refractive = True
    cycles.use_fast_gi = cycles.use_guiding = False
    cycles.denoising_input_passes = "RGB_ALBEDO_NORMAL"
    cycles.denoising_prefilter, cycles.denoising_quality = "ACCURATE", "HIGH"


def for_visibility(scene: Any, passes: Sequence[str] = ()) -> None:
    """One ray through each pixel's center, no light along it.

    Args:
        scene: Blender's scene.
        passes: Color passes that materials write.
    """
    cycles, layer = scene.cycles, scene.view_layers[0]
    if not layer.aovs:
        for name in passes:
            made = layer.aovs.add()
            made.name, made.type = name, "COLOR"
    # Sample 0 alone is centered, up to the resolution of the filter's table: a box of a pixel is
    # off by 5e-4 pixels, this filter by a hundredth of that.
    cycles.samples, cycles.use_sample_subset = 1, False
    cycles.pixel_filter_type, cycles.filter_width = "BLACKMAN_HARRIS", 0.01
    cycles.max_bounces = 0
    cycles.use_denoising = False


def for_radiance(scene: Any, bounces: int, samples: int, seed: int, denoise: bool) -> None:
    """All light, as the plain mean over each pixel.

    Args:
        scene: Blender's scene.
        bounces: See ``contract.BOUNCES``.
        samples: Per pixel.
        seed: Of the noise, 31 bits.
        denoise: Whether ``COMBINED`` is denoised, and ``NOISY`` there.
    """
    cycles, layer = scene.cycles, scene.view_layers[0]
    # Passes for visibility cost a thirtieth of the time.
    while layer.aovs:
        layer.aovs.remove(layer.aovs[0])
    # Cycles puts sample 0 at the pixel's center whatever the filter. Left in, it biases edges (and
    # with them the mean, by 1.5 % at one sample and 0.2 % at eight on a small scene) and is the
    # same in both halves. The second stretch of a length that is a power of two is as well spread
    # as the first.
    start = 1 << (samples - 1).bit_length()
    cycles.samples, cycles.use_sample_subset = start + samples, True
    cycles.sample_offset, cycles.sample_subset_length = start, samples
    cycles.seed = seed
    cycles.pixel_filter_type = "BOX"
    cycles.max_bounces = bounces
    cycles.use_denoising = denoise
    if denoise:
        cycles.denoiser = "OPENIMAGEDENOISE"


def draw(bpy: Any, scene: Any, passes: Sequence[str]) -> list[NDArray[np.float32]]:
    """Render; each of the passes asked for, [height, width, 4], top row first.

    Args:
        bpy: Blender.
        scene: Its scene, with a camera.
        passes: Names.

    Raises:
        BackendError: Cycles failed, or what it rendered cannot be read.
    """
    import OpenEXR

    with passing_file() as path:
        scene.render.filepath = str(path)
        try:
            with quiet():
                bpy.ops.render.render(write_still=True, scene=scene.name)
            with OpenEXR.File(str(path)) as source:
                parts = {part.name(): part for part in source.parts}
                names = [f"{_LAYER}.{name}" for name in passes]
                return [np.array(parts[name].channels[name].pixels) for name in names]
        except (RuntimeError, OSError, KeyError) as error:
            lines = str(error).strip().splitlines() or [type(error).__name__]
            raise BackendError(f"cycles: rendering failed: {lines[-1]}") from error
