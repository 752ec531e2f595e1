"""COLMAP's files as COLMAP itself reads them, against cameras and surfaces in closed form."""

from __future__ import annotations

import numpy as np
import pycolmap
import pytest

from scenec.datasets.export import Choice, export
from scenec.schemas.errors import OutputError
from scenec.testing.made_frames import LEFT, SIDE, camera_matrix, camera_pose, make_out, off_surface
from scenec.testing.made_output import edit


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    return make_out(tmp_path_factory.mktemp("out") / "made", (LEFT, SIDE), 3, 2).out


@pytest.mark.parametrize("model", ["text", "bin"])
def test_colmap_finds_the_cameras_the_poses_and_points_on_the_surfaces(made, tmp_path, model):
    export(made, "colmap", tmp_path / "set", Choice(options={"model": model, "points": "300"}))
    for batch in ("batch_0000", "batch_0001"):
        found = pycolmap.Reconstruction(str(tmp_path / f"set/all/{batch}/sparse/0"))
        assert len(found.cameras) == 2
        assert {image.name for image in found.images.values()} == {
            f"{one.name}/{sample:06d}.png" for one in (LEFT, SIDE) for sample in range(3)
        }
        for image in found.images.values():
            camera, name = found.cameras[image.camera_id], image.name.partition("/")[0]
            sensor = {one.name: one for one in (LEFT, SIDE)}[name]
            assert (tmp_path / f"set/all/{batch}/images/{image.name}").is_file()
            assert (camera.model_name, camera.width, camera.height) == ("PINHOLE", *sensor.size)
            k = camera_matrix(sensor)
            assert camera.params.tolist() == [k[0, 0], k[1, 1], k[0, 2], k[1, 2]]
            pose = np.linalg.inv(camera_pose(sensor, int(image.name[-10:-4])))
            matrix = image.cam_from_world().matrix()
            assert np.abs(matrix - pose[:3]).max() < 1e-12
            points = [p for p in image.points2D if p.has_point3D()]
            assert len(points) > 30
            for point in points[::7]:
                place = found.points3D[point.point3D_id].xyz
                assert np.abs(image.project_point(place) - point.xy).max() < 1e-4
        places = np.array([point.xyz for point in found.points3D.values()])
        assert off_surface(places).max() < 2e-5
        assert found.compute_mean_reprojection_error() == 0.0


@pytest.mark.parametrize(
    ("name", "coefficients"),
    [
        ("OPENCV", [-0.2, 0.05, 1e-3, -2e-3, 0, 0, 0, 0]),
        ("FULL_OPENCV", [0.1, 0.2, 0, 0, 0.3, 0.4, 0.5, 0.6]),
        ("OPENCV_FISHEYE", [-0.01, 2e-3, 3e-4, 0]),
    ],
)
def test_points_of_cameras_with_lenses_are_seen_where_colmap_projects_them(
    tmp_path, name, coefficients
):
    fisheye = {"model": "kannala_brandt", "max_angle_deg": 90}
    lens = fisheye if "FISHEYE" in name else {"model": "brown_conrady"}
    lens = lens | {"coefficients": coefficients}
    out = make_out(tmp_path / "out", (LEFT,), 1).out
    edit(out / "batch_0000/frames/mitsuba/rover_left/000000.json", lens=lens)
    export(out, "colmap", tmp_path / "set")
    found = pycolmap.Reconstruction(str(tmp_path / "set/all/batch_0000/sparse/0"))
    (camera,), (image,) = found.cameras.values(), found.images.values()
    assert camera.model_name == name
    assert camera.params[4:].tolist() == coefficients[: len(camera.params) - 4]
    points = [point for point in image.points2D if point.has_point3D()]
    for point in points:
        place = found.points3D[point.point3D_id].xyz
        assert np.abs(image.project_point(place) - point.xy).max() < 1e-3
    assert len(points) > 300


def test_without_depth_there_are_no_points_and_a_panorama_is_refused(tmp_path):
    out = make_out(tmp_path / "out", (LEFT,), 2, without=("depth",)).out
    export(out, "colmap", tmp_path / "set")
    found = pycolmap.Reconstruction(str(tmp_path / "set/all/batch_0000/sparse/0"))
    assert (len(found.images), len(found.points3D)) == (2, 0)
    edit(
        out / "batch_0000/frames/mitsuba/rover_left/000001.json",
        lens={"model": "equirectangular", "coefficients": []},
    )
    with pytest.raises(OutputError, match=r"rover_left.*equirectangular.*--cameras"):
        export(out, "colmap", tmp_path / "another")
