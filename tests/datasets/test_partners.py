"""Arrays of disparity come with the name of the camera that it goes to."""

from __future__ import annotations

import json
import tarfile

import h5py

from scenec.datasets.export import export
from scenec.testing.made_frames import LEFT, RIGHT, SIDE, make_out, rewrite


def test_hdf5_and_webdataset_name_the_camera_that_disparity_goes_to(tmp_path):
    made = make_out(tmp_path / "out", (LEFT, RIGHT, SIDE), 1)
    partners = {LEFT.name: RIGHT.name, RIGHT.name: LEFT.name}
    for (camera, sample), passes in made.passes.items():
        if camera in partners:
            stem = made.out / f"batch_0000/frames/mitsuba/{camera}/{sample:06d}"
            rewrite(stem, passes, partner=partners[camera])
    export(made.out, "hdf5", tmp_path / "h")
    with h5py.File(tmp_path / "h/all_64x48.h5") as file:
        told = [json.loads(text) for text in file["stereo"].asstr()]
        assert told == [{"partner": RIGHT.name}, {"partner": LEFT.name}]
    with h5py.File(tmp_path / "h/all_40x30.h5") as file:
        assert "stereo" not in file
    export(made.out, "webdataset", tmp_path / "w")
    with tarfile.open(tmp_path / "w/all-000000.tar") as tar:
        found = {}
        for name in tar.getnames():
            if name.endswith(".json"):
                values = json.load(tar.extractfile(name))
                found[values["camera"]] = values.get("partner")
    assert found == partners | {SIDE.name: None}
