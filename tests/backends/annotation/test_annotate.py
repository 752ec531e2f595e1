"""Annotation follows from first hits by closed forms, whatever the number of threads."""

from __future__ import annotations

import numpy as np
import pytest

from scenec.backends.annotation.annotate import annotate
from scenec.backends.annotation.passes import NO_FACE
from scenec.backends.annotation.registry import select
from scenec.backends.camera.rays import camera_rays
from scenec.backends.exact import ExactCaster
from scenec.schemas.errors import BackendError
from scenec.schemas.threads import at_most
from scenec.testing import scenes

ALL = ("label", "instance", "depth", "range", "normal", "position", "face")


@pytest.fixture(scope="module")
def rocks():
    """Ground with 3,000 rocks, most of them under two pixels; caster and camera."""
    scene = scenes.rocky(3000, 120, 40.0, seed=4, subdivisions=2)
    view = scenes.camera(
        200, 150, 65.0, scene.cameras[0][0].camera_to_world[:3, 3], (9.0, 2.0, -0.5)
    )
    return scene, ExactCaster(scene), view


def test_results_do_not_depend_on_the_number_of_threads(rocks):
    scene, caster, view = rocks
    many = annotate(scene, caster, view, ALL, 0).arrays
    with at_most(1):
        one = annotate(scene, caster, view, ALL, 0).arrays
    for name, values in one.items():
        assert values.tobytes() == many[name].tobytes(), name


def test_annotation_follows_from_the_hit():
    corners = [(5, -9, -9), (5, 9, -9), (5, 9, 1), (5, -9, 1)]
    wall = scenes.mesh(corners, [0, 1, 2, 0, 2, 3], [7, 8], np.array([3, 3], np.int32))
    view = scenes.camera(30, 40, 60.0)
    # A mirrored row turns the winding around; the normal must face the ray all the same.
    mirror = scenes.affine(np.diag([1.0, -1.0, 1.0]))
    scene = scenes.scene([wall], [(0, mirror)], [42])
    rays = camera_rays(view)
    out = annotate(scene, ExactCaster(scene), view, ALL, 0).arrays
    d = rays.directions.reshape(40, 30, 3)
    hit = d[..., 2] * 5 < 1
    assert hit.any()
    assert not hit.all()
    assert set(out) == {"label.class", "instance", "depth", "range", "normal", "position", "face"}
    np.testing.assert_allclose(out["depth"][hit], 5.0, rtol=1e-15)
    np.testing.assert_allclose(
        out["range"][hit], 5 * np.sqrt((d[hit] ** 2).sum(axis=1)), rtol=1e-15
    )
    np.testing.assert_array_equal(out["normal"][hit], np.broadcast_to((-1.0, 0, 0), d[hit].shape))
    np.testing.assert_allclose(out["position"][hit], 5 * d[hit], rtol=1e-14, atol=1e-14)
    assert set(np.unique(out["label.class"][hit])) == {7, 8}
    assert (out["instance"] == np.where(hit, 42, 0)).all()
    assert (out["face"] == np.where(hit, 3, NO_FACE)).all()
    assert np.isposinf(out["depth"][~hit]).all()
    assert np.isposinf(out["range"][~hit]).all()
    assert (out["normal"][~hit] == 0).all()
    assert np.isnan(out["position"][~hit]).all()
    assert (out["label.class"][~hit] == scenes.SKY).all()
    dtypes = {name: values.dtype for name, values in out.items()}
    integers = {"label.class", "instance", "face"}
    assert dtypes == {name: np.uint32 if name in integers else np.float64 for name in out}


def test_only_the_passes_asked_for_are_computed_and_unknown_ones_are_errors(rocks):
    scene, caster, view = rocks
    assert list(annotate(scene, caster, view, ["rgb", "depth"], 0).arrays) == ["depth"]
    assert list(select(scene, ["label.class", "label"])) == ["label.class"]
    with pytest.raises(BackendError, match="dept"):
        annotate(scene, caster, view, ["dept"], 0)
