# SPDX-License-Identifier: Apache-2.0
"""The package's functions: the examples of their docstrings run, on planted cameras, people and films."""

from __future__ import annotations

import doctest
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import studiorecon

from tests.made.cameras import detect, ring, walk


@pytest.mark.parametrize("name", ["triangulate", "associate", "refine", "score"])
def test_examples_of_docstrings_run(name: str, tmp_path: Path) -> None:
    cameras, rng = ring(), np.random.default_rng(0)
    people = [walk([-0.8, 0.0, 0.0], [0.02, 0.01, 0.0], 30), walk([0.8, 0.3, 0.0], [-0.01, 0.02, 0.0], 30, 1.0)]
    pose = cameras[1].camera_from_world.copy()
    pose[:3, 3] += [0.04, 0.0, 0.0]
    picture = rng.integers(0, 255, (48, 64, 3)).astype(np.uint8)
    for folder, noise in (("renders", 3), ("photos", 0)):
        (tmp_path / folder / "cam0").mkdir(parents=True)
        for t in range(2):
            noisy = np.clip(picture + rng.integers(-noise, noise + 1, picture.shape), 0, 255).astype(np.uint8)
            cv2.imwrite(str(tmp_path / folder / "cam0" / f"{t:03d}.png"), noisy)
    given = {
        "np": np,
        "studiorecon": studiorecon,
        "cameras": cameras,
        "folder": tmp_path,
        "detections": detect(cameras, people, 0.5, rng),
        "moved": [cameras[0], replace(cameras[1], camera_from_world=pose), *cameras[2:]],
    }
    (example,) = doctest.DocTestFinder(recurse=False).find(getattr(studiorecon, name), name, globs=given)
    assert example.examples, "a docstring without an example shows nothing"
    reported: list[str] = []
    ran = doctest.DocTestRunner(optionflags=doctest.NORMALIZE_WHITESPACE).run(example, out=reported.append)
    assert not ran.failed, "".join(reported)
