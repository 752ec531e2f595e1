"""A stage's ground from above: heights where it is, nothing elsewhere, the sun's direction."""

from __future__ import annotations

import numpy as np
import pytest

from scenec.backends.stage.ground import relief_of
from scenec.backends.stage.read import read_stage

STAGE = """#usda 1.0
(
    defaultPrim = "World"
    metersPerUnit = 1
    upAxis = "Z"
    startTimeCode = 0
    endTimeCode = 1
)
def Xform "World"
{
    def Mesh "Plane"
    {
        int[] faceVertexCounts = [3, 3]
        int[] faceVertexIndices = [0, 1, 2, 0, 2, 3]
        point3f[] points = [(0, 0, 0), (8, 0, 4), (8, 4, 2), (0, 4, -2)]
        uniform token subdivisionScheme = "none"
        double3 xformOp:translate = (10, 20, 1)
        uniform token[] xformOpOrder = ["xformOp:translate"]
    }
    def Mesh "Bridge"
    {
        int[] faceVertexCounts = [4]
        int[] faceVertexIndices = [0, 1, 2, 3]
        point3f[] points = [(12, 20, 9), (14, 20, 9), (14, 24, 9), (12, 24, 9)]
        uniform token subdivisionScheme = "none"
    }
    def Mesh "Stone"
    {
        custom uint scenec:instanceId = 7
        int[] faceVertexCounts = [3]
        int[] faceVertexIndices = [0, 1, 2]
        point3f[] points = [(10, 20, 50), (40, 20, 50), (10, 60, 50)]
        uniform token subdivisionScheme = "none"
    }
    def DistantLight "Sun"
    {
        float inputs:intensity = 100
        bool inputs:normalize = 1
        double xformOp:rotateX = 60
        uniform token[] xformOpOrder = ["xformOp:rotateX"]
    }
}
"""


def test_heights_are_those_of_the_highest_ground_and_instances_are_none(tmp_path):
    path = tmp_path / "stage.usda"
    path.write_text(STAGE)
    found = relief_of(read_stage(path), 80)
    assert found.heights.shape == (40, 80)
    assert found.step == pytest.approx((0.1, 0.1))
    assert found.corner == pytest.approx((10.05, 20.05))
    y, x = np.mgrid[0:40, 0:80]
    wx, wy = 10.05 + 0.1 * x, 20.05 + 0.1 * y
    plane = 1 + 0.5 * (wx - 10) - 0.5 * (wy - 20)
    bridge = (wx > 12) & (wx < 14)
    assert np.abs(found.heights - np.where(bridge, 9.0, plane)).max() < 1e-5


def test_the_sun_stands_where_its_light_comes_from(tmp_path):
    path = tmp_path / "stage.usda"
    path.write_text(STAGE)
    found = relief_of(read_stage(path), 8)
    assert len(found.suns) == 2
    # Along -z, turned by 60 degrees about x: from 30 degrees above the southern horizon.
    assert found.suns[0] == pytest.approx((30.0, 180.0))


def test_holes_have_no_height(tmp_path):
    path = tmp_path / "stage.usda"
    path.write_text(STAGE.replace("[3, 3]", "[3]").replace("[0, 1, 2, 0, 2, 3]", "[0, 1, 2]"))
    heights = relief_of(read_stage(path), 80).heights
    assert np.isnan(heights[39, 0])
    assert np.isfinite(heights[0, 79])
