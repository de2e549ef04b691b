# SPDX-License-Identifier: Apache-2.0
"""Fault injection: one in a hundred keypoint numbers is NaN, infinite or 0; people still come out, and the faults are
counted."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from studiorecon.camera_files.colmap import write_model
from studiorecon.configuration import settings as settings_module
from studiorecon.people import associate
from studiorecon.scene.camera import Lens
from studiorecon.scene.capture import Footage, Manifest, write_manifest
from studiorecon.scene.people import read_identities, read_people, write_detections
from studiorecon.scene.recorded_keypoints import RecordedKeypoints
from studiorecon.tracks import keypoints as detections

from tests.made.cameras import detect, ring, walk

FRAMES = 30
SHARE = 0.01
POISONS = pytest.mark.parametrize("poison", [np.nan, np.inf, -np.inf, 0.0], ids=["nan", "inf", "minus-inf", "zero"])


def poisoned(values: np.ndarray, poison: float, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """The values with one in a hundred replaced, and which rows of the last axis were hit."""
    hit = (rng.random(values.shape) < SHARE) & np.isfinite(values)
    return np.where(hit, poison, values), hit.any(-1)


def footage(camera: str, wh: tuple[int, int]) -> Footage:
    k = [[1000.0, 0, wh[0] / 2], [0, 1000, wh[1] / 2], [0, 0, 1]]
    return Footage(camera, False, wh, k, 30.0, FRAMES, 0, "cam.mp4", "", wh, 0, 0.0, [])


@pytest.fixture
def take():
    people = [walk([-0.6, -0.5, 0], [0.02, 0, 0], FRAMES), walk([0.7, 0.6, 0], [0, -0.02, 0], FRAMES, 2.0)]
    return ring(), detect(ring(), people, 1.0, np.random.default_rng(0))


def associated(folder: Path, cameras, found, default_settings) -> tuple[list[str], dict, dict]:
    options = settings_module.load(associate.Settings, default_settings("people"), "people")
    write_model(folder / "cameras", cameras)
    write_manifest(folder / "manifest.json", Manifest("x", 30.0, FRAMES, tuple(footage(c.name, c.wh) for c in cameras)))
    paths = [folder / f"{d.camera}.npz" for d in found]
    for path, d in zip(paths, found):
        write_detections(path, d)
    outputs = [folder / n for n in ("people.tsv", "identities.tsv", "association.json", "who")]
    associate.run(options, folder / "cameras/images.txt", folder / "manifest.json", paths, [], [], *outputs)
    return read_people(outputs[0]), read_identities(outputs[1]), json.loads(outputs[2].read_text())


@POISONS
def test_association_ends_counts_the_faults_and_finds_the_same_people(tmp_path, take, default_settings, poison):
    cameras, clean = take
    rng, faults, broken = np.random.default_rng(7), 0, []
    for d in clean:
        values, _ = poisoned(d.keypoints, poison, rng)
        if (
            poison == 0
        ):  # a single zero coordinate is a wrong place like any outlier; at (0, 0) a keypoint says that it is missing
            values = np.where((values[..., :2] == 0).any(-1)[..., None], [0.0, 0.0, 0.9], values)
            faults += int(((values[..., :2] == 0).all(-1) & (values[..., 2] > 0)).sum())
        else:
            there = d.keypoints[..., 2] > 0
            faults += int(((~np.isfinite(values).all(-1)) & (there | ~np.isfinite(values[..., 2]))).sum())
        broken.append(replace(d, keypoints=values))
    assert faults > 30
    people, identities, _ = associated(tmp_path / "clean", cameras, clean, default_settings)
    found, named, told = associated(tmp_path / "broken", cameras, broken, default_settings)
    assert (found, named) == (people, identities)
    assert told["unusable_keypoints"] == faults
    assert all(t["agreement"] > 0.95 for t in told["tracks"] if t["person"])


@POISONS
def test_detections_keep_their_tracks_and_what_was_not_hit(take, default_settings, capsys, poison):
    cameras, clean = take
    options = settings_module.load(detections.Settings, default_settings("tracks"), "tracks")
    camera, found = cameras[0], clean[0]
    lens = Lens(
        camera.name, camera.wh, camera.intrinsics, "opencv", np.zeros(5), camera.camera_from_world, np.eye(2, 3)
    )
    values, hit = poisoned(found.keypoints, poison, np.random.default_rng(3))

    def read(keypoints: np.ndarray):
        given = RecordedKeypoints("made", np.unique(found.frame), found.frame, keypoints, True, "coco17")
        return detections.detections_from_recorded(given, lens, footage(camera.name, camera.wh), options)

    before, after = read(np.nan_to_num(found.keypoints)), read(values)
    assert np.array_equal(after.frame, before.frame)
    assert np.array_equal(after.track, before.track)
    assert np.isfinite(after.keypoints[..., 2]).all()
    assert np.isnan(after.keypoints[after.keypoints[..., 2] == 0][:, :2]).all()
    there = (before.keypoints[..., 2] > 0) & ~hit
    np.testing.assert_array_equal(after.keypoints[there], before.keypoints[there])
    said = capsys.readouterr().out
    if poison != 0:
        count = int(
            (~np.isfinite(values).all(-1) & ((found.keypoints[..., 2] > 0) | ~np.isfinite(values[..., 2]))).sum()
        )
        assert f"{count} of {values[..., 0].size} keypoints are not finite" in said
