# SPDX-License-Identifier: Apache-2.0
"""Stand-ins for upstream networks in a house (``tests.workflow.conftest``): each says what the studio's truth says, in
the network's own unit and manner, from files that ``plant`` writes beside the weights.

A house has its own copy of the package. ``plant`` puts this module into it and lets the adapters' last lines take these
classes, so that everything around a network is what a user's run has: plan, rules, command lines, files.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

UNIT = 0.6
"""Of Pi3's unit in a metre; MoGe's depth is another one and a shift besides."""
_MOGE_SCALE, _MOGE_SHIFT_M = 0.8, 0.3
_THUMB = 4


class Pi3:
    """Cameras and depth of the first moment in a world that begins at the first camera, in a unit of its own."""

    def __init__(self, card: Any, weights: Path, where: str) -> None:
        self._held = dict(np.load(Path(weights) / "planted/pi3.npz"))

    def reconstruct(self, pictures: Sequence[np.ndarray], names: Sequence[str]) -> Any:
        from studiorecon.models.protocols import Reconstruction
        from studiorecon.scene.camera import Camera

        cameras, depths = [], []
        for name, picture in zip(names, pictures):
            depth, pose = self._held[f"{name}.depth"], self._held[f"{name}.pose"].copy()
            assert picture.shape[:2] == depth.shape, "the network sees the footage"
            pose = pose @ np.linalg.inv(self._held[f"{names[0]}.pose"])
            pose[:3, 3] *= UNIT
            cameras.append(Camera(name, depth.shape[::-1], self._held[f"{name}.lens"], pose))
            depths.append((depth * UNIT).astype(np.float32))
        sure = [np.where(depth > 0, 0.9, 0).astype(np.float32) for depth in depths]
        return Reconstruction(cameras, depths, sure, [0.1] * len(cameras), False)


class Moge:
    """Depth of one picture, found again among the studio's by what it shows."""

    def __init__(self, card: Any, weights: Path, where: str) -> None:
        held = np.load(Path(weights) / "planted/moge.npz")
        self._thumbs, self._depths = held["thumbs"].astype(np.float32), held["depths"]

    def depth(self, picture: np.ndarray, focal_px: float | None) -> np.ndarray:
        from studiorecon.images.sizes import resample_nearest

        own = picture[::_THUMB, ::_THUMB].astype(np.float32)
        shown = int(np.abs(self._thumbs - own).mean((1, 2, 3)).argmin())
        depth_m = resample_nearest(self._depths[shown], picture.shape[:2])
        return np.where(depth_m > 0, (depth_m - _MOGE_SHIFT_M) / _MOGE_SCALE, 0).astype(np.float32)


class Difix:
    """Makes every picture a little warmer."""

    def __init__(self, card: Any, weights: Path, where: str, seed: int) -> None:
        assert seed == 0

    def enhance(self, image: np.ndarray, reference: np.ndarray, moment: Any) -> np.ndarray:
        assert reference.ndim == 3
        return np.clip(image + np.float32([0.02, 0, -0.02]), 0, 1).astype(np.float32)


class Raft:
    """Flow by dense inverse search."""

    def __init__(self, card: Any, weights: Path, where: str) -> None:
        from studiorecon.recursive.flows import DisFlow

        self._search = DisFlow("fast")

    def flow(self, first: np.ndarray, second: np.ndarray) -> np.ndarray:
        return self._search.flow(first, second)


def plant(house: Any, weights: Path) -> None:
    """Put the stand-ins into a house in which the studio ``tiny`` ran, their truth and LPIPS' random weights below
    ``weights``."""
    import torch
    from studiorecon.body.model import BodyModel
    from studiorecon.body.person_files import read_person
    from studiorecon.footage.video import read_stack
    from studiorecon.images.silhouette import mesh_depth
    from studiorecon.models.adapters.lpips import TRUNKS
    from studiorecon.models.catalogue.registry import MODELS
    from studiorecon.report.metrics.truth import read_views

    from tests.made.vgg import random_weights

    truth, capture = house.folder / "results/studio/tiny/truth", house.folder / "results/tiny/capture"
    body = BodyModel.load(house.folder / "resources/body.npz")
    people = [read_person(path) for path in sorted((truth / "bodies").glob("*.npz"))]
    pi3: dict[str, np.ndarray] = {}
    thumbs, depths = [], []
    for name, view in read_views(truth).items():
        lens, shape = view.camera.intrinsics, view.room_depth_m.shape
        for t, picture in enumerate(read_stack(capture / f"{name}.mkv")):
            depth = view.room_depth_m.astype(np.float32)
            for person in people:
                vertices = body.vertices(person.poses[[t]], person.betas, person.trans[[t]], body.proxy_vertices)[0]
                theirs = mesh_depth(vertices, body.proxy_faces, view.camera)
                depth = np.where((theirs > 0) & (theirs < depth), theirs, depth)
            if t == 0:
                pi3 |= {f"{name}.depth": depth, f"{name}.pose": view.camera.camera_from_world, f"{name}.lens": lens}
            thumbs.append(picture[::_THUMB, ::_THUMB])
            depths.append(depth.astype(np.float32))
            assert depth.shape == shape
    (weights / "planted").mkdir(parents=True)
    np.savez(weights / "planted/pi3.npz", **pi3)
    np.savez(weights / "planted/moge.npz", thumbs=np.stack(thumbs), depths=np.stack(depths))
    # A run begins only where every file of its networks exists; the stand-ins open none of them.
    for name in ("pi3", "moge", "difix", "raft"):
        for file in MODELS[name].weights:
            (weights / file.path).parent.mkdir(parents=True, exist_ok=True)
            (weights / file.path).touch()
    (weights / "lpips").mkdir()
    for net, trunk in TRUNKS.items():
        for file, values in zip((trunk.features_file, trunk.heads_file), random_weights(torch.float32, net=net)):
            torch.save(values, weights / "lpips" / file)
    package = house.folder / "workflow"
    (package / "planted_networks.py").write_text(Path(__file__).read_text(encoding="utf-8"), encoding="utf-8")
    for name, stands_in in (("pi3", "Pi3"), ("moge", "Moge"), ("difix", "Difix"), ("raft", "Raft")):
        with open(package / f"studiorecon/models/adapters/{name}.py", "a", encoding="utf-8") as adapter:
            adapter.write(f"\nfrom planted_networks import {stands_in} as ADAPTER  # noqa\n")
