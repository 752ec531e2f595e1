"""The suite notices what is wrong, and its reference is the definitions by hand."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import pytest
from numpy.typing import NDArray

from scenec.backends.contract import Radiance, Visibility
from scenec.backends.exact import ExactCaster
from scenec.backends.stage.scene import Lighting, Maps, RenderScene, Surface
from scenec.backends.testing import Conformance, Lacks, Tolerance, lights, looks, reference
from scenec.backends.testing.scenes import look_at, mesh, plane, scene, sun, surface
from scenec.backends.testing.tolerance import judge

CLOSE = Tolerance(1e-3, 5e-3, "float32")


class Definition:
    """Shows the reference, as it is or changed; its witness is the exact caster."""

    name = "definition"
    devices = ("cpu",)
    device = "cpu"
    denoiser = None
    stochastic = False

    def __init__(self, factor: float = 1.0, shift: int = 0, losses: tuple[str, ...] = ()) -> None:
        self.factor, self.shift, self.lines = factor, shift, losses

    def losses(self, scene: RenderScene) -> tuple[str, ...]:
        """As told."""
        return self.lines

    def load(self, scene: RenderScene) -> None:
        """Build the caster."""
        self.scene, self.caster = scene, ExactCaster(scene)

    def witness(self, rays, sample, camera=None) -> Visibility:
        """Exact hits, moved by some pixels."""
        row, face, _ = self.caster.cast(rays)
        return Visibility(np.roll(row, self.shift), np.roll(face, self.shift))

    def radiance(self, camera, sample, spp, seed, denoise=False) -> Radiance:
        """The reference's light, moved and brightened."""
        expected = reference.picture(self.scene, sample)
        light = np.roll(self.factor * expected.radiance, self.shift, axis=1)
        return Radiance(np.stack([light, light]), expected.coverage, spp, stochastic=False)


@contextmanager
def checks(**changes) -> Iterator[Conformance]:
    """The suite, of a changed definition."""

    class Held(Conformance):
        backend = staticmethod(lambda: Definition(**changes))

    Held.setup_class()
    try:
        yield Held()
    finally:
        Held.teardown_class()


@pytest.mark.parametrize(
    ("changes", "check", "case", "message"),
    [
        ({"factor": 1.002}, "lambert", "low sun", r"mean radiance is off by \+0\.200%"),
        ({"factor": 0.998}, "gloss", "steep", r"mean radiance is off by -0\.200%"),
        ({"shift": 1}, "maps", "color", r"pixels are off by \d.*worst at column"),
        ({"shift": 1}, "projections", "triplanar color, plain", "pixels are off by"),
        ({"shift": 1}, "witness", "field", "pixels show another surface than the annotation"),
        ({"shift": 2}, "sun_shadows", "square", "pixels are off by"),
    ],
)
def test_what_is_off_is_said_with_what_is_allowed(changes, check, case, message):
    with (
        checks(**changes) as held,
        pytest.raises(AssertionError, match=rf"definition: {check}\[{case}\]: .*{message}") as said,
    ):
        getattr(held, f"test_{check}")(case)
    assert "llowed" in str(said.value)


def test_the_definition_itself_conforms():
    with checks() as held:
        for check, case in (("lambert", "low sun"), ("gloss", "steep"), ("witness", "field")):
            getattr(held, f"test_{check}")(case)


def picture(light: NDArray, noise: float = 0.0) -> Radiance:
    """Halves of light that differ by noise."""
    off = noise * np.random.default_rng(1).normal(size=(2, *light.shape))
    return Radiance((light * (1.0 + off)).astype(np.float32), np.ones(light.shape[:2]), 2)


def test_noise_explains_what_it_can_and_no_more():
    even = np.full((20, 20, 3), 2.0)
    judge("even", picture(even, 0.05), even, CLOSE)
    with pytest.raises(AssertionError, match="mean radiance is off by"):
        judge("bright", picture(1.03 * even, 0.05), even, CLOSE)
    with pytest.raises(AssertionError, match="too noisy to be judged"):
        judge("loud", picture(even, 0.5), even, CLOSE)
    broken = even.copy()
    broken[3, 4] = np.nan
    with pytest.raises(AssertionError, match="3 values are not finite"):
        judge("broken", picture(broken), even, CLOSE)
    with pytest.raises(AssertionError, match="only 0 pixels can be judged, of 100"):
        judge("nothing", picture(even), even, CLOSE, np.zeros((20, 20), bool))


def test_tolerances_are_of_checks_that_there_are_and_have_reasons():
    with pytest.raises(ValueError, match=r"no check 'lamberd\[low sun\]'; did you mean 'lambert'"):
        type("Wrong", (Conformance,), {"tolerances": {"lamberd[low sun]": CLOSE}})
    with pytest.raises(ValueError, match="'lambert' has no reason"):
        type("Silent", (Conformance,), {"tolerances": {"lambert": Lacks("")}})


def test_what_is_lacking_has_to_be_said():
    table = {"lambert": Lacks("it is night")}
    with checks(losses=("it is night",)) as said, checks() as silent:
        for held in (said, silent):
            type(held).tolerances = table
        with pytest.raises(pytest.skip.Exception, match="it is night"):
            said.test_lambert("low sun")
        with pytest.raises(pytest.fail.Exception, match="DID NOT RAISE"):
            silent.test_lambert("low sun")


# The reference


def shown(made: RenderScene) -> NDArray:
    return reference.picture(made).radiance.mean(axis=(0, 1))


def test_ggx_is_that_of_a_half_vector_by_hand():
    # Sun and camera 30 degrees to either side of a normal: the half vector is the normal itself,
    # D = 1 / (pi alpha^2), tan^2 = 1 / 3 for both.
    roughness = 0.6
    made = scene(
        [mesh(*plane())],
        [Surface("", (1.0, 0.5, 0.25), 0.0, roughness, 0.0, 1.0)],
        cameras=[look_at((5.0, 0.0, 5.0 * np.sqrt(3.0)), (0, 0, 0), 4, 4, 0.01)],
        lights=[sun(60.0, 180.0, diameter_deg=0.0)],
    )
    alpha2 = roughness**4
    hidden = 0.5 * (np.sqrt(1.0 + alpha2 / 3.0) - 1.0)
    lobe = 1.0 / (np.pi * alpha2) / (1.0 + 2.0 * hidden) / (4.0 * 0.75)
    color = np.array([1.0, 0.5, 0.25])
    # What facets reflect to each other: E and its mean by numbers, where the model has polynomials.
    nodes, parts = np.polynomial.legendre.leggauss(12)
    cosines = 0.5 * (nodes + 1.0)
    shares = np.array([reference.lobe_albedo(roughness, mu, 200) for mu in cosines])
    mean = (shares * cosines * parts).sum()
    once = reference.lobe_albedo(roughness, np.sqrt(0.75))
    again = color * mean / (1.0 - color * (1.0 - mean)) * (1.0 - once) / once
    expected = 1000.0 * np.sqrt(0.75) * lobe * color * (1.0 + again)
    np.testing.assert_allclose(shown(made), expected, rtol=5e-3)
    np.testing.assert_allclose(
        shown(made)[0] / shown(made)[1], expected[0] / expected[1], rtol=1e-3
    )


@pytest.mark.parametrize(("roughness", "mu"), [(0.3, 0.7), (0.6, 0.4), (1.0, 0.9)])
def test_the_lobes_albedo_is_its_integral(roughness, mu):
    nodes = 800
    theta = (np.arange(nodes) + 0.5) * (np.pi / 2 / nodes)
    phi = (np.arange(nodes) + 0.5) * (2 * np.pi / nodes)
    t, p = np.meshgrid(theta, phi, indexing="ij")
    wi = np.stack([np.sin(t) * np.cos(p), np.sin(t) * np.sin(p), np.cos(t)], -1).reshape(-1, 3)
    wo = np.broadcast_to([np.sqrt(1.0 - mu * mu), 0.0, mu], wi.shape)
    up = np.broadcast_to([0.0, 0.0, 1.0], wi.shape)
    lobe = reference.ggx(np.full(len(wi), roughness**2), up, wi, wo)
    weight = (np.cos(t) * np.sin(t)).ravel() * (np.pi / 2 / nodes) * (2 * np.pi / nodes)
    assert reference.lobe_albedo(roughness, mu) == pytest.approx((lobe * weight).sum(), rel=2e-3)


def test_a_map_lies_on_the_world_u_along_x_and_v_along_y(tmp_path):
    # The middle of a texel of a picture that repeats every 5 m: a texel a meter.
    file = looks.write_picture(tmp_path, "base_color")
    own = dataclasses.replace(surface((0.5, 0.5, 0.5)), maps=Maps(5.0, base_color=file))
    texels = np.random.default_rng(11).integers(60, 200, (5, 5, 3)) / 255.0
    linear = ((texels + 0.055) / 1.055) ** 2.4
    for row, column in ((0, 0), (4, 1), (2, 3)):
        at = np.array([10.5 + column, -0.5 - row, 0.0])
        made = scene(
            [mesh(*plane())],
            [own],
            cameras=[look_at(at + np.array([0.0, 0.0, 5.0]), at, 4, 4, 1e-3)],
            lights=[sun(90.0)],
        )
        expected = 0.5 * linear[row, column] * 1000.0 / np.pi
        np.testing.assert_allclose(shown(made), expected, rtol=1e-3)


def test_a_lamp_is_the_inverse_square_and_its_cone_a_smooth_step():
    # At 20 degrees within a cone of 30 whose edge begins at 12: x = 8 / 18.
    made = lights.lamp_scene({"20 degrees off": lights.LAMPS["20 degrees off a cone's axis"]})
    x = 8.0 / 18.0
    expected = np.array([60.0, 30.0, 10.0]) / 9.0 / np.pi * (1.0 - x * x * (3.0 - 2.0 * x))
    np.testing.assert_allclose(shown(made), expected, rtol=1e-4)


def test_shadows_leave_nothing_and_their_edges_are_not_judged():
    made = lights.shadow_scene({"up": Lighting((sun(90.0),), ())})
    expected = reference.picture(made)
    # Straight below the square, which hides its own shadow but for the perspective.
    assert expected.radiance[16, 24].max() == 0.0
    assert expected.sound[16, 24]
    assert not expected.sound.all()
    open_ground = 0.05 * 1000.0 / np.pi
    np.testing.assert_allclose(expected.radiance[2, 2], open_ground, rtol=1e-12)
