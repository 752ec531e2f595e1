"""The checks, as a class of tests that each backend's own class of tests inherits.

Pictures are held against closed forms and against ``reference``, first hits against the exact
caster. What noise explains is let pass (``tolerance.judge``); what else a renderer may be off by,
its own table says.
"""

from __future__ import annotations

import dataclasses
import os
import tempfile
from collections.abc import Callable, Collection, Mapping
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest
from numpy.typing import NDArray

from scenec.backends.camera.rays import camera_rays
from scenec.backends.check.witness import Witness
from scenec.backends.contract import NO_ROW, Backend, Radiance, Visibility, completed
from scenec.backends.exact import ExactCaster
from scenec.backends.stage.scene import Lighting, RenderScene
from scenec.backends.surface import facets
from scenec.backends.surface.reflectance import albedo
from scenec.backends.testing import geometry, lights, looks, reference
from scenec.backends.testing.scenes import (
    dome,
    look_at,
    mesh,
    plane,
    scene,
    sun,
    with_lights,
)
from scenec.backends.testing.tolerance import (
    PIXEL_NOISE,
    STANDARD_ERRORS,
    Table,
    Tolerance,
    allowed,
    judge,
    require_valid,
)
from scenec.schemas.errors import BackendError

#: Samples a pixel, times ``effort``.
SAMPLES = 64
SEED = 3
#: Pixels that a check has to have.
LEAST = 50


def _witnesses(backend: Backend) -> bool:
    """Tells whether a backend ever bears witness."""
    return type(backend).witness is not Backend.witness


class Conformance:
    """Tests the rules that every backend follows; see the package.

    Attributes:
        backend: The class, or what else makes a backend; it is given ``device`` where
            SCENEC_TEST_DEVICE names one.
        tolerances: By check ("lambert") or case ("lambert[low sun]").
        effort: What samples a pixel are multiplied with.
    """

    backend: ClassVar[Callable[..., Backend]]
    tolerances: ClassVar[Table] = {}
    effort: ClassVar[float] = 1.0

    _folder: ClassVar[tempfile.TemporaryDirectory[str]]
    _renderer: ClassVar[Any]
    _scenes: ClassVar[dict[str, RenderScene]]
    _loaded: ClassVar[RenderScene | None]

    def __init_subclass__(cls, **more: Any) -> None:
        super().__init_subclass__(**more)
        checks = [name.removeprefix("test_") for name in dir(cls) if name.startswith("test_")]
        require_valid(cls.tolerances, checks)

    @classmethod
    def setup_class(cls) -> None:
        """Start the renderer, once for all checks."""
        cls._folder = tempfile.TemporaryDirectory()
        looks.write_pictures(cls.folder())
        cls._scenes, cls._loaded = {}, None
        cls._renderer = cls.start()

    @classmethod
    def start(cls) -> Any:
        """A backend, on the device that the environment names, or its own choice."""
        device = os.environ.get("SCENEC_TEST_DEVICE")
        backend = completed(cls.backend) if isinstance(cls.backend, type) else cls.backend
        return backend(device=device) if device else backend()

    @classmethod
    def teardown_class(cls) -> None:
        """Leave nothing behind."""
        cls._renderer = cls._loaded = None
        cls._folder.cleanup()

    # What checks are made of

    @classmethod
    def folder(cls) -> Path:
        """Returns the folder of pictures of maps and skies."""
        return Path(cls._folder.name)

    def scene(self, name: str, make: Callable[[], RenderScene]) -> RenderScene:
        """A scene by name, made once."""
        if name not in self._scenes:
            self._scenes[name] = make()
        return self._scenes[name]

    def case(
        self, check: str, case: str, cases: Collection[str], make: Callable[[], RenderScene]
    ) -> tuple[RenderScene, int]:
        """The scene of a check, and the sample that shows a case; skips what is lacking."""
        made, sample = self.scene(check, make), list(cases).index(case)
        self.allow(check, case, made, sample)
        return made, sample

    def allow(self, check: str, case: str, scene: RenderScene, sample: int = 0) -> Tolerance:
        """Returns a check's tolerance; skips the check if the renderer lacks that, and says so.

        It says so in its losses, or refuses to draw.
        """
        entry = allowed(self.tolerances, check, case)
        if isinstance(entry, Tolerance):
            return entry
        lines = self._renderer.losses(scene)
        assert all(line and "\n" not in line for line in lines), lines
        if not lines:
            with pytest.raises(BackendError) as raised:
                self.draw(scene, sample)
            assert "\n" not in str(raised.value), str(raised.value)
        pytest.skip(entry.reason)

    def ready(self, scene: RenderScene) -> Any:
        """The renderer, with a scene loaded."""
        if self._loaded is not scene:
            type(self)._loaded = None
            self._renderer.load(scene)
            type(self)._loaded = scene
        return self._renderer

    def draw(
        self, scene: RenderScene, sample: int = 0, spp: float = SAMPLES, seed: int = SEED
    ) -> Radiance:
        """A picture of ``effort`` times as many samples."""
        count = max(2, round(spp * self.effort))
        radiance: Radiance = self.ready(scene).radiance(
            scene.cameras[sample][0], sample, count, seed
        )
        return radiance

    def hold(
        self,
        check: str,
        case: str,
        scene: RenderScene,
        sample: int,
        expected: NDArray[np.float64] | reference.Expected,
        spp: float = SAMPLES,
    ) -> None:
        """Draw a sample and judge it."""
        tolerance = self.allow(check, case, scene, sample)
        radiance = self.draw(scene, sample, spp)
        what = self.title(check, case)
        if isinstance(expected, reference.Expected):
            judge(what, radiance, expected.radiance, tolerance, expected.sound, LEAST)
        else:
            judge(what, radiance, expected, tolerance, None, LEAST)

    def board(
        self, check: str, group: Mapping[str, looks.Look], case: str, side: int = 4, disc: int = 1
    ) -> None:
        """Hold one of a group of looks against the reference."""
        made, sample = self.case(check, case, group, lambda: looks.boards(group))
        self.hold(check, case, made, sample, reference.picture(made, sample, side, disc))

    def shadow(self, check: str, lighting: Mapping[str, Lighting], case: str) -> None:
        """Hold shadows against the reference; black is no more than is allowed of the brightest."""
        made, sample = self.case(check, case, lighting, lambda: lights.shadow_scene(lighting))
        expected = reference.picture(made, sample)
        dark = expected.sound & (expected.radiance[..., 0] == 0.0) & (expected.coverage == 1.0)
        assert dark.sum() > 20
        self.hold(check, case, made, sample, expected)
        brightest = self.draw(made, sample).halves.mean(axis=0)[dark].max()
        most = self.allow(check, case, made, sample).pixel * expected.radiance.max()
        assert brightest <= most, f"{self.title(check, case)}: {brightest:g} in a shadow"

    def near(
        self, shares: NDArray[np.float64] | np.floating, right: float, what: str, samples: int = 1
    ) -> None:
        """Hold shares against a probability that so many samples estimate; a hair is let pass."""
        most = 2e-3 + STANDARD_ERRORS * np.sqrt(right * (1.0 - right) / samples)
        off = np.abs(shares - right).max()
        assert off <= most, f"{self.title(what)}: off by {off:.4f}; allowed are {most:.4f}"

    def witness(self, scene: RenderScene, sample: int = 0) -> Visibility | None:
        """First hits of a camera's rays; None if it cannot tell. Skips if it never does."""
        if not _witnesses(self._renderer):
            pytest.skip("it bears no witness")
        camera = scene.cameras[sample][0]
        hits: Visibility | None = self.ready(scene).witness(camera_rays(camera), sample, camera)
        return hits

    def see(self, check: str, case: str, scene: RenderScene, sample: int = 0) -> None:
        """Hold first hits against the exact ones."""
        what, tolerance = self.title(check, case), self.allow(check, case, scene, sample)
        seen = self.witness(scene, sample)
        assert seen is not None, f"{what}: it bears no witness"
        rays, caster, witness = camera_rays(scene.cameras[sample][0]), ExactCaster(scene), Witness()
        caster.pose(sample)
        witness.add(caster, rays, seen)
        assert witness.beyond == 0, (
            f"{what}: {witness.beyond} of {witness.pixels} pixels show another surface than the "
            f"annotation; to see it, rays would have to be off by up to {witness.farthest_px:g} "
            "pixels. Allowed is a hair: 1/64, or what float32 does to coordinates of this size"
        )
        row, face, _ = caster.cast(rays)
        if len(row) < LEAST:
            return
        other_row = seen.row != row
        other_face = other_row | ((row != NO_ROW) & (seen.face != face))
        for name, share, most in (
            ("row", other_row.mean(), tolerance.mean),
            ("face", other_face.mean(), tolerance.pixel),
        ):
            assert share <= most, (
                f"{what}: {share:.3%} of pixels show another {name}, each within a hair of its "
                f"edge; allowed are {most:.3%} ({tolerance.reason})"
            )

    def stochastic(self) -> bool:
        """Whether it has noise."""
        return self._renderer.stochastic

    def title(self, check: str, case: str = "") -> str:
        """Returns the title of a check's messages."""
        return f"{self._renderer.name}: {check}" + (f"[{case}]" if case else "")

    # What a backend is

    def test_it_says_what_it_is(self) -> None:
        """Names and lines that sidecars and the command line show."""
        renderer = self._renderer
        assert renderer.name
        assert renderer.device in renderer.devices
        for line in (renderer.version(), renderer.warning() or "fine"):
            assert line, "an empty line"
            assert "\n" not in line, line
        assert renderer.denoiser is None or isinstance(renderer.denoiser, str)

    def test_without_a_scene_it_says_so(self) -> None:
        """In one line, whatever is asked first."""
        fresh: Any = self.start()
        with pytest.raises(BackendError) as raised:
            fresh.radiance(lights.ABOVE, 0, 2, SEED)
        assert "\n" not in str(raised.value), str(raised.value)
        if _witnesses(fresh):
            with pytest.raises(BackendError) as raised:
                fresh.witness(camera_rays(lights.ABOVE), 0, lights.ABOVE)
            assert "\n" not in str(raised.value), str(raised.value)

    # What is seen

    @pytest.mark.parametrize("case", geometry.SEEN)
    def test_witness(self, case: str) -> None:
        """First hits are the annotation's, but for a hair."""
        self.see("witness", case, self.scene(f"witness {case}", geometry.SEEN[case]))

    @pytest.mark.parametrize("case", geometry.INTRINSICS)
    def test_intrinsics(self, case: str) -> None:
        """Any focal lengths, principal point and skew are followed, by witness and radiance."""
        made, sample = self.case("intrinsics", case, geometry.INTRINSICS, geometry.varied_views)
        coverage = self.draw(made, sample, 16).coverage.astype(np.float64)
        exact = reference.coverage(made, sample)
        # A pixel is covered by each sample or not; the reference knows sixteenths.
        spread = np.sqrt(np.mean(exact * (1.0 - exact)) / 16.0 + 1.0 / 16.0**2)
        most = (PIXEL_NOISE + STANDARD_ERRORS / np.sqrt(exact.size)) * spread
        off = np.sqrt(np.mean((coverage - exact) ** 2))
        assert off < most, (
            f"{self.title('intrinsics', case)}: coverage is off by {off:.3f} (root mean square); "
            f"allowed are {most:.3f} for noise"
        )
        self.see("intrinsics", case, made, sample)

    def test_radiance_and_witness_leave_each_other_alone(self) -> None:
        """Nor do two backends in one process, nor one scene after another."""
        made = with_lights(geometry.field(), [sun(40.0), dome(5.0)])
        camera = made.cameras[0][0]
        before = self.witness(made)
        assert before is not None
        self.draw(made, 0, 4)
        other: Any = self.start()
        other.load(lights.white_ball())
        after = self.witness(made)
        other.load(made)
        again = other.witness(camera_rays(camera), 0, camera)
        for seen in (after, again):
            assert seen is not None
            np.testing.assert_array_equal(before.row, seen.row)
            np.testing.assert_array_equal(before.face, seen.face)

    @pytest.mark.parametrize("shift", [0.0, 0.25, 0.5, 0.75])
    def test_coverage(self, shift: float) -> None:
        """Coverage is the share of a pixel's area, and one sample is not at the center alone."""
        made = geometry.edge(shift)
        height, spp = made.cameras[0][0].height, max(2, round(SAMPLES * self.effort))
        columns = self.draw(made).coverage.astype(np.float64).mean(axis=0)
        self.near(columns[:12], 1.0, "coverage inside of an edge")
        self.near(columns[12], shift, "coverage at an edge", spp * height)
        self.near(columns[13:], 0.0, "coverage beyond an edge")
        if self.stochastic() and shift > 0.0:
            few = [self.draw(made, 0, 0.0, seed).coverage[:, 12] for seed in range(8)]
            self.near(np.mean(few), shift, "coverage by single samples", 2 * 8 * height)

    def test_sky_and_suns_are_left_to_shared_code(self) -> None:
        """They are neither in the light of surfaces nor in coverage, which may be 0 everywhere."""
        view = look_at((0, 0, 2), (1000, 0, 2), 16, 12)
        bare = scene([mesh(*plane(1e4))], cameras=[view])
        radiance = self.draw(with_lights(bare, [sun(5.0, diameter_deg=20.0), dome(7.0)]))
        assert np.all(radiance.coverage[:5] == 0.0)
        assert np.all(radiance.halves[:, :5] == 0.0)
        assert np.all(radiance.coverage[7:] == 1.0)
        # Beside what gives off light, too.
        radiance = self.draw(with_lights(lights.panel_scene(1.0), [dome(7.0)]), 0, 16)
        assert radiance.coverage[0, 0] == 0.0
        assert not radiance.halves[:, 0, 0].any()
        assert radiance.coverage[-1, 12] == 1.0
        assert not self.draw(geometry.empty(), 0, 2).coverage.any()

    # Light

    @pytest.mark.parametrize("case", lights.OVER_PLANE)
    def test_lambert(self, case: str) -> None:
        """A gray plane shows albedo / pi of what falls on it, at each sample of its light."""
        made, sample = self.case("lambert", case, lights.OVER_PLANE, lights.plane_scene)
        self.hold("lambert", case, made, sample, lights.plane_radiance(case))
        assert np.all(self.draw(made, sample, 2).coverage == 1.0)

    def test_furnace(self) -> None:
        """A white convex body vanishes in an even sky."""
        made = self.scene("furnace", lights.white_ball)
        self.hold("furnace", "", made, 0, np.full(3, 3.0))
        assert self.draw(made, 0, 2).coverage.min() == 1.0

    def test_sheet_furnace(self) -> None:
        """Nor is a white sheet seen there, which transmits what it does not reflect."""
        made = self.scene("sheet_furnace", lights.white_sheet)
        self.hold("sheet_furnace", "", made, 0, np.full(3, 3.0), 4 * SAMPLES)

    def test_cavity(self) -> None:
        """Light between surfaces: as many as the contract says, and no bias of few samples."""
        made = self.scene("cavity", lights.bowl)
        tolerance = self.allow("cavity", "", made)
        # Many small sets rather than one of all: samples whose dimensions depend on each other
        # are biased in these.
        means = np.array([self.draw(made, 0, 32, seed).halves.mean() for seed in range(10)])
        expected = lights.bowl_radiance()
        error = means.std(ddof=1) / np.sqrt(len(means)) / expected
        assert error < 2e-3, f"{self.title('cavity')}: too noisy to be judged: {error:.3%}"
        # Nine degrees of freedom: beyond 7 standard errors once in 15,000 runs.
        off = means.mean() / expected - 1.0
        assert abs(off) <= tolerance.mean + 7.0 * error, (
            f"{self.title('cavity')}: {means.mean():.5f} where {expected:.5f} is right, off by "
            f"{off:+.3%}; allowed are {tolerance.mean:.3%} ({tolerance.reason}) and "
            f"{7.0 * error:.3%} for noise"
        )

    @pytest.mark.parametrize("case", lights.FACING)
    def test_sky(self, case: str) -> None:
        """A square shows albedo / pi of what a picture of a sky sends to its side."""
        made, sample = self.case(
            "sky", case, lights.FACING, lambda: lights.squares_under_sky(self.folder())
        )
        self.hold("sky", case, made, sample, lights.under_sky(made, case), 4 * SAMPLES)

    @pytest.mark.parametrize("case", lights.GOBOS)
    def test_gobos(self, case: str) -> None:
        """The picture that a sun shines through lies on ground of any height."""
        made, sample = self.case(
            "gobos", case, lights.GOBOS, lambda: lights.gobo_scene(self.folder())
        )
        expected = reference.picture(made, sample, side=8)
        for around in made.lighting[sample].domes:
            radiance = expected.radiance + lights.ALBEDO * np.asarray(around.scale)
            expected = dataclasses.replace(expected, radiance=radiance)
        self.hold("gobos", case, made, sample, expected, 2 * SAMPLES)

    @pytest.mark.parametrize("case", lights.SUN_SHADOWS)
    def test_sun_shadows(self, case: str) -> None:
        """They lie where suns throw them, and those of what is out of view do."""
        self.shadow("sun_shadows", lights.SUN_SHADOWS, case)

    @pytest.mark.parametrize("case", lights.CUTOUTS)
    def test_cutouts(self, case: str) -> None:
        """Parts that a picture of opacity cuts out hide nothing and throw no shadow."""
        made, sample = self.case(
            "cutouts", case, lights.CUTOUTS, lambda: lights.cutout_scene(self.folder())
        )
        # Where contours run, and edges of shadows, samples on a lattice do not tell means.
        expected = reference.picture(made, sample, side=8)
        self.hold("cutouts", case, made, sample, expected)
        self.see("cutouts", case, made, sample)

    @pytest.mark.parametrize("case", lights.LAMP_SHADOWS)
    def test_lamp_shadows(self, case: str) -> None:
        """They lie where lamps throw them."""
        self.shadow("lamp_shadows", lights.LAMP_SHADOWS, case)

    @pytest.mark.parametrize("case", lights.LAMPS)
    def test_lamps(self, case: str) -> None:
        """A white plane shows what lamps give it by their law."""
        made, sample = self.case("lamps", case, lights.LAMPS, lights.lamp_scene)
        expected = reference.picture(made, sample, side=8)
        if made.lighting[sample].domes:
            radiance = expected.radiance + lights.SKY
            expected = dataclasses.replace(expected, radiance=radiance)
        # One that picks a lamp by chance needs more of many.
        spp = 4 * SAMPLES * max(1, len(made.lighting[sample].lamps) // 3)
        self.hold("lamps", case, made, sample, expected, spp)

    @pytest.mark.parametrize("case", lights.ODD_LAMPS)
    def test_odd_lamps(self, case: str) -> None:
        """Whatever a lamp is, its light is finite and not negative."""
        made, sample = self.case(
            "odd_lamps", case, lights.ODD_LAMPS, lambda: lights.lamp_scene(lights.ODD_LAMPS)
        )
        radiance = self.draw(made, sample, 4)
        assert np.isfinite(radiance.halves).all()
        assert radiance.halves.min() >= 0.0
        assert radiance.dropped == 0

    def test_half_shadow(self) -> None:
        """A spherical lamp's light behind an edge is the share of its disc that the edge leaves."""
        made = self.scene("half_shadow", lights.edge_scene)
        self.hold("half_shadow", "", made, 0, lights.edge_shadow(), 8 * SAMPLES)

    def test_cameras_do_not_see_lamps(self) -> None:
        """Nor do they cover anything."""
        radiance = self.draw(lights.lamp_in_view(), 0, 16)
        assert radiance.halves[:, :3].max() == 0.0
        assert radiance.coverage[:3].max() == 0.0

    @pytest.mark.parametrize("turn", [1.0, -1.0])
    def test_glow(self, turn: float) -> None:
        """An emitter is seen with its own radiance, and lights its neighbor, from both sides."""
        made = self.scene(f"glow {turn}", lambda: lights.panel_scene(turn))
        tolerance = self.allow("glow", "", made)
        expected, (panel, ground) = lights.panel_radiance(made)
        radiance = self.draw(made, 0, 8 * SAMPLES)
        shown = radiance.halves.mean(axis=0)[panel]
        np.testing.assert_allclose(shown, np.broadcast_to(lights.GLOW, shown.shape), rtol=1e-5)
        judge(self.title("glow"), radiance, expected, tolerance, ground, LEAST)

    # Surfaces

    @pytest.mark.parametrize("case", looks.dull())
    def test_colors(self, case: str) -> None:
        """Layers, variation and normals of dull surfaces are the shared model's."""
        self.board("colors", looks.dull(), case)

    @pytest.mark.parametrize("case", looks.glossy())
    def test_gloss(self, case: str) -> None:
        """Lobes, metals and roughness that varies are GGX by hand."""
        self.board("gloss", looks.glossy(), case)

    @pytest.mark.parametrize("case", looks.mapped(Path()))
    def test_maps(self, case: str) -> None:
        """Maps from above, in cells, of two scales and mixed by heights are as defined."""
        self.board("maps", looks.mapped(self.folder()), case)

    @pytest.mark.parametrize("case", looks.projected(Path()))
    def test_projections(self, case: str) -> None:
        """Maps lie on objects as defined, from three sides and by texture coordinates."""
        self.board("projections", looks.projected(self.folder()), case)

    @pytest.mark.parametrize("case", looks.sheets(Path()))
    def test_sheets(self, case: str) -> None:
        """Light behind a thin sheet shows through it, its share of the color / pi."""
        self.board("sheets", looks.sheets(self.folder()), case)

    @pytest.mark.parametrize("case", looks.planetary())
    def test_laws(self, case: str) -> None:
        """The laws of the Moon and of Mars, over a sun's whole disc."""
        self.board("laws", looks.planetary(), case, side=1, disc=200)

    @pytest.mark.parametrize("case", looks.LAWS)
    def test_laws_under_a_sky(self, case: str) -> None:
        """A plane shows the law's albedo towards its viewer."""
        made, sample = self.case("laws_under_a_sky", case, looks.LAWS, looks.laws_under_sky)
        color = np.array(made.surfaces[sample].base_color)
        shown = albedo(looks.LAWS[case], color, np.array([looks.cosine(made)]))[:, 0]
        self.hold("laws_under_a_sky", case, made, sample, looks.SKY * shown, 4 * SAMPLES)

    def test_facets_under_a_sky(self) -> None:
        """Facets that hide each other show what they do of an even sky."""
        made = self.scene("facets_under_a_sky", lambda: looks.facets_under_sky(self.folder()))
        self.allow("facets_under_a_sky", "", made)
        own, cosine = made.surfaces[0], np.array([looks.cosine(made)])
        share = facets.under_even_sky(np.array([facets.deviation(own)]), cosine)[0, 0]
        shown = looks.SKY * share * np.array(own.base_color)
        self.hold("facets_under_a_sky", "", made, 0, shown, 4 * SAMPLES)

    @pytest.mark.parametrize("case", looks.METALS)
    def test_metals_under_a_sky(self, case: str) -> None:
        """A metal shows its color times the albedo of its lobe; the smoothest is a mirror."""
        made, sample = self.case("metals_under_a_sky", case, looks.METALS, looks.metals_under_sky)
        shown = reference.metal_albedo(made.surfaces[sample], looks.cosine(made))
        self.hold("metals_under_a_sky", case, made, sample, looks.SKY * shown, 4 * SAMPLES)

    # Time

    @pytest.mark.parametrize("sample", [2, 0, 3, 1])
    def test_moving_rows(self, sample: int) -> None:
        """They are seen and lit where they are at a sample, in any order; hidden ones are not."""
        made = self.scene("moving_rows", geometry.moving)
        expected = reference.picture(made, sample)
        self.hold("moving_rows", str(sample), made, sample, expected)
        self.see("moving_rows", str(sample), made, sample)

    # Noise

    def require_one_picture(self, first: Radiance, second: Radiance) -> None:
        """Hold two pictures of one seed against each other: to the bit, but for a GPU's rounding.

        A GPU's threads may add light up in any order.
        """
        rtol = 0.0 if self._renderer.device == "cpu" else 1e-6
        np.testing.assert_allclose(first.halves, second.halves, rtol=rtol)
        np.testing.assert_allclose(first.coverage, second.coverage, rtol=rtol)

    def test_seeds(self) -> None:
        """One seed is one picture, and the halves' difference estimates the error."""
        made = self.scene("noise", geometry.busy)
        radiance, camera = self.ready(made).radiance, made.cameras[0][0]
        first, second = (radiance(camera, 0, 8, 5) for _ in range(2))
        self.require_one_picture(first, second)
        assert first.stochastic == self.stochastic()
        if not first.stochastic:
            np.testing.assert_array_equal(first.halves[0], first.halves[1])
            return
        assert first.spp >= 8
        halves = np.array([radiance(camera, 0, 8, seed).halves for seed in range(48)], np.float64)
        stated = np.mean((0.5 * (halves[:, 0] - halves[:, 1])) ** 2)
        means = halves.mean(axis=1)
        # Across seeds, so not what the halves share; and against a long sum, so biases as well.
        long = [radiance(camera, 0, 1024, seed).halves for seed in (90, 91)]
        true = np.mean(long, axis=(0, 1), dtype=np.float64)
        assert stated == pytest.approx(means.var(axis=0, ddof=1).mean(), rel=0.12)
        assert stated == pytest.approx(((means - true) ** 2).mean(), rel=0.12)

    def test_denoising_leaves_the_halves_alone(self) -> None:
        """And is finite, and dark where nothing is."""
        if self._renderer.denoiser is None:
            pytest.skip("it has no denoiser")
        made = self.scene("noise", geometry.busy)
        radiance, camera = self.ready(made).radiance, made.cameras[0][0]
        plain, denoised = (radiance(camera, 0, 8, 1, denoise=asked) for asked in (False, True))
        assert plain.denoised is None
        self.require_one_picture(plain, denoised)
        assert np.isfinite(denoised.denoised).all()
        assert np.all(denoised.denoised[plain.coverage == 0.0] == 0.0)

    # Lenses

    @pytest.mark.parametrize("case", geometry.LENSES)
    def test_lenses(self, case: str) -> None:
        """In even light every pixel with a ray shows it, and no other."""
        if not self._renderer.follows_lenses:
            pytest.skip("it draws pinhole views, of which shared code makes pictures of lenses")
        made = geometry.inside_glow(case)
        rays = camera_rays(made.cameras[0][0])
        known = np.ones(rays.shape, bool) if rays.known is None else rays.known.reshape(rays.shape)
        radiance = self.draw(made, 0, 4)
        np.testing.assert_allclose(radiance.halves[:, known], 1.0, atol=1e-5)
        np.testing.assert_allclose(radiance.coverage, known, atol=1e-5)
        assert not radiance.halves[:, ~known].any()
