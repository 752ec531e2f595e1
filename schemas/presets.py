"""Lists cameras that people own: what a cfg's ``preset`` stands for, and where numbers are from.

A preset is a part of a cfg: keys of a sensor; the sensor's own go before, key by key. What no
source says is left at scenec's defaults. ``SOURCES`` were read in excerpts; those that end in
``MEMORY`` were not at hand when this was written: their numbers are from memory.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

from scenec.schemas.codec import JsonObject

MEMORY: Final = "not opened: from memory"
#: By the names that presets cite.
SOURCES: Final = {
    "flir": "Teledyne FLIR, Specifications and Frame Rates of the model: pixels and pitch",
    "mv": "Matrix Vision, mvBlueFOX3 Technical Documentation: full well and read noise follow "
    "from SNRmax 40.3 dB and dynamic range 71.2 dB (IMX250), 45.1 and 73 dB (IMX249), as EMVA 1288 "
    "defines them",
    "basler": "Basler, ace GigE acA1920-40gc, General Specifications: pixels and pitch",
    "intel_step": "Grunnet-Jepsen and others (Intel), Subpixel Linearity Improvement for RealSense "
    "D400: 848 px across 90°, steps of 1/32 px",
    "rotors": "ETH Zurich, rotors_simulator, D435DepthNoiseModel, after Intel's Best-Known-Methods "
    "for Tuning D400: baseline 50 mm, rms error of disparities 0.1 px",
    "framos": "FRAMOS, D435e manual, Color Sensor: pixels, 69.4°, f/2.0, 10 bits",
    "intel_sheet": "Intel, RealSense D400 data sheet 337029: depths within 2 % at 2 m, fill "
    f"rate 99 %, ranges, pixels of 1.4 µm; full well and read noise are typical of such; {MEMORY}",
    "zed_sheet": "Stereolabs, ZED 2 data sheet: baseline 120 mm, errors below 1 % up to 3 m and "
    f"5 % up to 15 m (one law in Z² meets both), pixels of 2 µm, f/1.8; {MEMORY}",
    "zed_docs": "Stereolabs, documentation, Depth Settings (2.1 mm lens: 0.3 to 20 m) and Depth "
    "Sensing (110°)",
    "kinect": "Tölgyessy and others, Sensors 21 (2021) 413: the stated deviation of 17 mm "
    "and distance error of 11 mm hold up to 3.5 m",
    "kinect_sheet": "Microsoft, Azure Kinect DK hardware specifications: 640 x 576 (NFOV "
    "unbinned), 75°, 0.5 to 3.86 m",
    "mastcam_z": "Mars 2020 Mastcam-Z characteristics, Table 5 of PMC7883548 (left camera)",
    "malin": "MSL Mastcam and MARDI characteristics, Table 1 of PMC5652233",
    "maki2020": "Maki and others, Space Science Reviews 216 (2020) 137, abstract: 96° at 0.33 and "
    "136° at 0.46 mrad a pixel, as equidistant lenses have them",
    "maki2012": "Maki and others, Space Science Reviews 170 (2012) 77, abstract",
    "cmv20000": f"ams, CMV20000 data sheet: 5120 x 3840 of 6.4 µm, full well, read noise; "
    f"f/12; {MEMORY}",
    "mer": "Maki and others, J. Geophysical Research 108 (2003) 8071: pitch, full well, read "
    f"noise, f-numbers; {MEMORY}",
    "sony": f"IMX219 and IMX477: all but names; {MEMORY}",
    "emva": f"FLIR, EMVA 1288 imaging performance of the model: full well, read noise; {MEMORY}",
}


@dataclass(frozen=True)
class Preset:
    """Describes a camera.

    Attributes:
        title: What it is.
        keys: Of a sensor of the cfg.
        sources: Keys of ``SOURCES``.
    """

    title: str
    keys: JsonObject
    sources: tuple[str, ...]


def _camera(
    title: str, size: tuple[int, int], pixel_um: float, *sources: str, **more: Any
) -> Preset:
    """A camera whose noise is that of its sensor; ``more`` are keys of imaging, and ``sees``."""
    sees = more.pop("sees", {})
    imaging = {"pixel_um": pixel_um, **more}
    return Preset(title, {"resolution": [*size], **sees, "imaging": imaging}, sources)


_FISHEYE: Final = {"lens": {"type": "kannala_brandt"}}
_GRAY: Final = {"mosaic": "none"}

PRESETS: Final = {
    "mvbluefox3_2051": _camera(
        "Matrix Vision mvBlueFOX3-2051 (Sony IMX250)", (2464, 2056), 3.45, "mv",
        full_well_e=10_700, read_noise_e=2.5, bits=12,
    ),
    "bfs_u3_51s5": _camera(
        "FLIR Blackfly S BFS-U3-51S5 (Sony IMX250)", (2448, 2048), 3.45, "emva",
        full_well_e=10_400, read_noise_e=2.3, bits=12,
    ),
    "bfs_u3_32s4": _camera(
        "FLIR Blackfly S BFS-U3-32S4 (Sony IMX252)", (2048, 1536), 3.45, "flir", "emva",
        full_well_e=10_500, read_noise_e=2.3, bits=12,
    ),
    "bfs_u3_04s2": _camera(
        "FLIR Blackfly S BFS-U3-04S2 (Sony IMX287)", (720, 540), 6.9, "flir", "emva",
        full_well_e=22_000, read_noise_e=4.5, bits=12,
    ),
    "bfs_u3_244s8": _camera(
        "FLIR Blackfly S BFS-U3-244S8 (Sony IMX540)", (5320, 4600), 2.74, "flir", "emva",
        full_well_e=9_500, read_noise_e=2.3, bits=12,
    ),
    "aca1920_40gc": _camera(
        "Basler ace acA1920-40gc (Sony IMX249)", (1920, 1200), 5.86, "basler", "mv",
        full_well_e=32_400, read_noise_e=6.7, bits=12,
    ),
    "raspberry_pi_v2": _camera(
        "Raspberry Pi Camera Module 2 (Sony IMX219)", (3280, 2464), 1.12, "sony",
        sees={"fov_deg": 62.2}, full_well_e=4_300, read_noise_e=2.5, bits=10, f_number=2.0,
    ),
    "raspberry_pi_hq": _camera(
        "Raspberry Pi HQ Camera (Sony IMX477)", (4056, 3040), 1.55, "sony",
        full_well_e=8_000, read_noise_e=2.5, bits=12,
    ),
    "realsense_d435_color": _camera(
        "Intel RealSense D435, color", (1920, 1080), 1.4, "framos", "intel_sheet",
        sees={"fov_deg": 69.4}, f_number=2.0, bits=10, full_well_e=5_000, read_noise_e=3.0,
    ),
    "realsense_d435": Preset(
        "Intel RealSense D435, depth at 848 x 480",
        {
            "resolution": [848, 480],
            "fov_deg": 90,
            "depth_camera": {
                "type": "stereo",
                "baseline_m": 0.05,
                "noise_px": 0.1,
                "step_px": 0.03125,
                # 2 % at 2 m are 0.04 * 424 px * 0.05 m / (2 m)² of disparity.
                "bias_px": {"type": "uniform", "min": -0.212, "max": 0.212},
                "lost": 0.01,
                "range_m": [0.2, 10],
            },
        },
        ("intel_step", "rotors", "intel_sheet"),
    ),
    "zed_2": Preset(
        "Stereolabs ZED 2, depth at 1920 x 1080",
        {
            "resolution": [1920, 1080],
            "fov_deg": 110,
            "depth_camera": {
                "type": "stereo",
                "baseline_m": 0.12,
                # 1 % at 3 m, and so 5 % at 15 m: 0.03 / 9 * 0.12 m * (960 px / tan(55 degrees)).
                "noise_px": 0.2689,
                "step_px": 0,
                "range_m": [0.3, 20],
            },
            "imaging": {"pixel_um": 2.0, "f_number": 1.8},
        },
        ("zed_docs", "zed_sheet"),
    ),
    "azure_kinect": Preset(
        "Microsoft Azure Kinect DK, depth, narrow field of view, unbinned",
        {
            "resolution": [640, 576],
            "fov_deg": 75,
            "depth_camera": {
                "type": "time_of_flight",
                "noise_m": 0.017,
                "at_m": 3.5,
                "ambiguity_m": 1000,
                "blur_px": 0.4,
                "bias_m": {"type": "uniform", "min": -0.011, "max": 0.011},
                "range_m": [0.5, 3.86],
            },
        },
        ("kinect", "kinect_sheet"),
    ),
    "mastcam_z_wide": _camera(
        "Mars 2020 Mastcam-Z at 26 mm", (1600, 1200), 7.4, "mastcam_z",
        sees={"fov_deg": 25.6}, f_number=6.7, full_well_e=21_826, read_noise_e=22, bits=11,
    ),
    "mastcam_z_tele": _camera(
        "Mars 2020 Mastcam-Z at 110 mm", (1600, 1200), 7.4, "mastcam_z",
        sees={"fov_deg": 6.2}, f_number=9.5, full_well_e=21_826, read_noise_e=22, bits=11,
    ),
    "m2020_navcam": _camera(
        "Mars 2020 Navcam", (5120, 3840), 6.4, "maki2020", "cmv20000",
        sees={"fov_deg": 96, **_FISHEYE},
        f_number=12, full_well_e=15_000, read_noise_e=8, bits=12,
    ),
    "m2020_hazcam": _camera(
        "Mars 2020 Hazcam", (5120, 3840), 6.4, "maki2020", "cmv20000",
        sees={"fov_deg": 136, **_FISHEYE},
        f_number=12, full_well_e=15_000, read_noise_e=8, bits=12,
    ),
    "msl_mastcam_34": _camera(
        "MSL Mastcam, 34 mm", (1200, 1200), 7.4, "malin",
        sees={"fov_deg": 15.0}, f_number=8, full_well_e=26_150, read_noise_e=18, bits=11,
    ),
    "msl_mastcam_100": _camera(
        "MSL Mastcam, 100 mm", (1200, 1200), 7.4, "malin",
        sees={"fov_deg": 5.1}, f_number=10, full_well_e=23_308, read_noise_e=15.8, bits=11,
    ),
    "msl_mardi": _camera(
        "MSL Mars Descent Imager", (1600, 1200), 7.4, "malin",
        sees={"fov_deg": 70, **_FISHEYE},
        f_number=3, full_well_e=29_454, read_noise_e=17.5, bits=11,
    ),
    "msl_navcam": _camera(
        "MSL Navcam", (1024, 1024), 12, "maki2012", "mer",
        sees={"fov_deg": 45},
        f_number=12, full_well_e=170_000, read_noise_e=25, bits=12, **_GRAY,
    ),
    "msl_hazcam": _camera(
        "MSL Hazcam", (1024, 1024), 12, "maki2012", "mer",
        sees={"fov_deg": 124, **_FISHEYE},
        f_number=15, full_well_e=170_000, read_noise_e=25, bits=12, **_GRAY,
    ),
}  # fmt: skip


def with_presets(document: Any) -> Any:
    """Returns a cfg with what the presets of its sensors stand for.

    What a sensor says itself goes before, and null takes a preset's key away. What is no cfg, or
    names no preset, stays as it is.
    """
    rigs = document.get("rigs") if isinstance(document, dict) else None
    if not isinstance(rigs, dict):
        return document
    return {**document, "rigs": {name: _of_rig(rig) for name, rig in rigs.items()}}


def _of_rig(rig: Any) -> Any:
    sensors = rig.get("sensors") if isinstance(rig, dict) else None
    if not isinstance(sensors, dict):
        return rig
    return {**rig, "sensors": {name: _of_sensor(sensor) for name, sensor in sensors.items()}}


def _of_sensor(sensor: Any) -> Any:
    name = sensor.get("preset") if isinstance(sensor, dict) else None
    if not isinstance(name, str) or name not in PRESETS:
        return sensor
    keys = PRESETS[name].keys
    if "intrinsics" in sensor:
        keys = {key: value for key, value in keys.items() if key != "fov_deg"}
    return _over(keys, sensor)


def _over(preset: JsonObject, own: JsonObject) -> JsonObject:
    result = {**preset}
    for key, value in own.items():
        below = preset.get(key)
        if value is None and key in preset:
            del result[key]
        elif isinstance(below, dict) and isinstance(value, dict):
            same = "type" not in value or value["type"] == below.get("type")
            result[key] = _over(below, value) if same else value
        else:
            result[key] = value
    return result


def table() -> str:
    """Returns all presets and their sources, in Markdown."""
    heads = ["`preset`", "camera", "pixels", "fov", "pitch, µm", "full well, e-", "read noise, e-"]
    heads += ["depth", "sources"]
    lines = [f"| {' | '.join(heads)} |", "|---" * len(heads) + "|"]
    numbers = {name: str(i) for i, name in enumerate(SOURCES, 1)}
    for name, preset in PRESETS.items():
        keys, imaging = preset.keys, preset.keys.get("imaging", {})
        size = " × ".join(map(str, keys["resolution"]))
        fov = f"{keys['fov_deg']}°" if "fov_deg" in keys else ""
        told = [str(imaging.get(key, "")) for key in ("pixel_um", "full_well_e", "read_noise_e")]
        depth = keys.get("depth_camera", {}).get("type", "").replace("_", " ")
        cited = ", ".join(f"[{numbers[source]}]" for source in preset.sources)
        row = [f"`{name}`", preset.title, size, fov, *told, depth, cited]
        lines.append(f"| {' | '.join(row)} |".replace("  ", " "))
    lines += ["", *(f"- [{numbers[name]}] {text}." for name, text in SOURCES.items())]
    return "\n".join(lines) + "\n"
