# SPDX-License-Identifier: Apache-2.0
"""What tests of humans and their neighbours share."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from studiorecon.body.avatar.avatar_files import read_avatar
from studiorecon.body.avatar.posing import Posing
from studiorecon.body.avatar.weight_grid import strongest_weights
from studiorecon.body.model import BodyModel, upright_global_orientation
from studiorecon.body.person_files import write_person
from studiorecon.camera_files.colmap import write_model
from studiorecon.footage.video import to_bytes, write_lossless
from studiorecon.humans.surface_samples import gaussians_on, sample_surface
from studiorecon.images.metrics import psnr
from studiorecon.scene.camera import Camera
from studiorecon.scene.capture import Footage, Manifest, write_manifest
from studiorecon.scene.gaussians import Gaussians, sh_from_rgb
from studiorecon.scene.people import Person, write_people

from tests.made.fitted import fitted_person
from tests.made.gaussians import rasterise
from tests.made.scene import ring

WH = (112, 96)


FRAMES = 6


@pytest.fixture(scope="module")
def body(root: Path) -> BodyModel:
    return BodyModel.load(root / "resources" / "body.npz")


@dataclass(frozen=True)
class Made:
    """A made person, dressed in coloured bands, filmed before a checkered wall by four cameras."""

    folder: Path
    options: dict
    person: Person
    posed: Callable[[int], Gaussians]


def motion_of(body: BodyModel) -> tuple[np.ndarray, np.ndarray]:
    """Poses (T, 72) and pelvis positions (T, 3): turning on the spot, arms swinging."""
    swing = np.sin(np.linspace(0, 2 * np.pi, FRAMES))
    poses = np.zeros((FRAMES, 72))
    for frame, s in enumerate(swing):
        poses[frame, :3] = upright_global_orientation(0.4 + 0.5 * s)
    poses[:, 16 * 3 + 2], poses[:, 17 * 3 + 2] = -0.9 + 0.4 * swing, 0.9 + 0.4 * swing
    poses[:, 1 * 3], poses[:, 2 * 3] = -0.4 * swing, 0.4 * swing
    return poses, np.stack([0.1 * swing, 0 * swing, np.full(FRAMES, 0.95)], axis=1)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory, root: Path, body: BodyModel) -> Made:
    folder = tmp_path_factory.mktemp("humans")
    cameras = ring([0, 90, 180, 270], "cam", wh=WH)
    write_model(folder / "cameras", cameras)
    poses, trans = motion_of(body)
    samples = sample_surface(body.rest_vertices(np.zeros(10)), body.faces, body.weights, 9000, np.random.default_rng(1))
    height = samples.points_m[:, 1]
    rgb = np.stack(
        [0.5 + 0.4 * np.sin(9 * height), 0.5 + 0.4 * np.sin(7 * height + 2), 0.4 + 0.3 * np.cos(11 * height)], axis=1
    )
    dressed = gaussians_on(samples, 0)
    dressed.sh[:, 0] = sh_from_rgb(rgb)
    posing = Posing(*strongest_weights(samples.weights, 4))
    transforms = body.joint_transforms(poses, np.zeros(10), trans)

    def posed(frame: int) -> Gaussians:
        carried = posing.out(dressed.means_m, dressed.quaternions, dressed.sh, transforms[frame])
        return Gaussians(*carried[:2], dressed.log_scales, dressed.logit_opacities, carried[2])

    wall = np.where(
        (np.add.outer(np.arange(WH[1]) // 6, np.arange(WH[0]) // 6) % 2)[..., None], [0.9, 0.9, 0.2], [0.1, 0.3, 0.1]
    )
    footage, options = [], {"videos": [], "masks": []}
    for camera in cameras:
        pictures, masks = [], []
        for frame in range(FRAMES):
            seen = rasterise(posed(frame), camera, near_m=0.05)
            pictures.append(to_bytes(seen.rgb + wall * (1 - seen.alpha[..., None])))
            masks.append(np.where(seen.alpha > 0.5, 2, 0).astype(np.uint8))
        for kind, frames in (("videos", pictures), ("masks", masks)):
            options[kind].append(folder / f"{camera.name}.{kind}.mkv")
            write_lossless(options[kind][-1], frames, 30.0)
        footage.append(
            Footage(camera.name, False, WH, camera.intrinsics.tolist(), 30.0, FRAMES, 0, "made", "", WH, 0, 0.0, [])
        )
    write_manifest(folder / "manifest.json", Manifest("made", 30.0, FRAMES, tuple(footage)))
    # The person is the second in the table: masks label them 2.
    write_people(
        folder / "people.tsv", [("p0", FRAMES, "cam0", 1.0, "keypoints"), ("p3", FRAMES, "cam0", 1.0, "keypoints")]
    )
    joints = body.joints(poses, np.zeros(10), trans)
    person = fitted_person(
        "p3", body.identity, 30.0, FRAMES, poses=poses, trans=trans, joints=joints, sigma=np.full((FRAMES, 24), 0.01)
    )
    write_person(folder / "p3.npz", person)
    options |= {
        "person": "p3",
        "model": folder / "cameras/images.txt",
        "manifest": folder / "manifest.json",
        "people": folder / "people.tsv",
        "fit": folder / "p3.npz",
        "body": root / "resources/body.npz",
        "threads": 1,
    }
    return Made(folder, options, person, posed)


def score(made: Made, body: BodyModel, folder: Path, cameras: list[Camera]) -> float:
    """Mean PSNR of the person's own pixels from cameras that were not trained on."""
    trained = read_avatar(folder / "p3.ply", folder / "p3.npz", body)
    values = []
    for camera in cameras:
        truth, shown = (rasterise(g, camera, near_m=0.05) for g in (made.posed(2), trained.posed(2)))
        values.append(psnr(shown.rgb, truth.rgb, truth.alpha > 0.5))
    return float(np.mean(values))
