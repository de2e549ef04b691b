# SPDX-License-Identifier: Apache-2.0
"""The identity page: everybody's pictures, doubtful tracks first, rejected ones with their reason, on a page without a
network."""

from __future__ import annotations

import base64
import re
from pathlib import Path

import cv2
import numpy as np
import pytest
from studiorecon.footage.video import write_lossless
from studiorecon.people import review
from studiorecon.scene.files import write_json
from studiorecon.scene.people import Detections, write_detections, write_identities, write_people

WH, FRAMES = (160, 120), 8


def standing_at(x: float, y: float) -> np.ndarray:
    """(17, 3) keypoints of a box of 30 × 60 pixels."""
    rng = np.random.default_rng(0)
    return np.column_stack([x + rng.uniform(-15, 15, 17), y + rng.uniform(-30, 30, 17), np.full(17, 0.9)])


@pytest.fixture
def page(tmp_path: Path) -> str:
    found, videos = [], []
    for v, camera in enumerate(("left", "right & <far>")):
        frame = np.concatenate([np.arange(FRAMES), np.arange(FRAMES), [5]])
        track = np.concatenate([np.zeros(FRAMES, int), np.ones(FRAMES, int), [2]])
        places = (
            [standing_at(40 + t, 60) for t in range(FRAMES)] + [standing_at(110, 60)] * FRAMES + [standing_at(-50, 300)]
        )
        found.append(Detections(camera, "coco17", frame, track, np.array(places)))
        videos.append(tmp_path / f"{v}.mkv")
        # The left half of every picture is red, the right half blue: a cut-out shows whom it was cut from.
        picture = np.zeros((WH[1], WH[0], 3), np.uint8)
        picture[:, :80, 0], picture[:, 80:, 2] = 200, 200
        write_lossless(videos[-1], iter([picture] * FRAMES), 30.0)
        write_detections(tmp_path / f"{camera}.npz", found[-1])
    tracks = []
    for camera in (d.camera for d in found):
        for track, person, margin, reason in (
            (0, "p0", 0.6, ""),
            (1, "p1", 0.02, "undecided: it prefers p1"),
            (2, "", None, "nobody there"),
        ):
            about = {"camera": camera, "track": track, "first": 0, "last": 7, "detections": FRAMES if track < 2 else 1}
            tracks.append(about | {"person": person, "margin": margin, "reason": reason})
    tracks[4]["margin"] = 0.01
    out = {
        "name": "r0",
        "seconds": 0.3,
        "cameras": ["left", "right & <far>"],
        "reason": "a bystander",
        "tracks": [["left", 2], ["right & <far>", 2]],
        "lines": ["left\t2\tp3"],
    }
    write_json(tmp_path / "association.json", {"corrected": False, "tracks": tracks, "left_out": [out]})
    rows = [
        ("p0", 8, "left", 0.9, "keypoints"),
        ("p1", 8, "left", 0.8, "keypoints"),
        ("p2", 8, "left", 0.7, "keypoints"),
    ]
    write_people(tmp_path / "people.tsv", rows, [("r0", 1, "left", 0.5, "keypoints", "rejected", "a bystander")])
    write_identities(tmp_path / "identities.tsv", {(t["camera"], t["track"]): t["person"] for t in tracks})
    tables = [tmp_path / n for n in ("association.json", "people.tsv", "identities.tsv")]
    for name in ("desk.html", "again.html"):
        review.run(*tables, [tmp_path / "left.npz", tmp_path / "right & <far>.npz"], videos, tmp_path / name)
    assert (tmp_path / "desk.html").read_bytes() == (tmp_path / "again.html").read_bytes()
    return (tmp_path / "desk.html").read_text()


def test_the_narrowest_margin_comes_first_and_every_rejected_track_has_its_reason(page: str) -> None:
    doubtful = page[page.index("Doubtful tracks first") : page.index('class="who">p0')]
    assert doubtful.index("right &amp; &lt;far&gt;/1") < doubtful.index("left/1")
    rejected = page[page.index("Rejected tracks") :]
    assert rejected.count("nobody there") == 2
    assert "left/2" in rejected
    assert "identities.tsv" in rejected
    assert "left\t0\tp0" in rejected


def test_the_pictures_show_who_they_say(page: str) -> None:
    for alt, channel in (("p0 left", 0), ("p1 left", 2)):
        sources = re.findall(rf'src="data:image/jpeg;base64,([^"]+)"[^>]*alt="{alt}', page)
        assert len(sources) == 6
        for source in sources:
            picture = cv2.imdecode(np.frombuffer(base64.b64decode(source), np.uint8), cv2.IMREAD_COLOR)[..., ::-1]
            assert picture.shape[0] == 150
            assert picture.reshape(-1, 3).mean(0).argmax() == channel


def test_the_page_needs_no_network_and_escapes_names(page: str) -> None:
    assert not re.search(r'(src|href)="(?!data:)', page)
    assert "http" not in page
    assert "<far>" not in page
    assert "left out: a bystander" in page
    assert "left\t2\tp3" in page


def test_nobody_is_a_page_too(tmp_path: Path) -> None:
    write_json(tmp_path / "a.json", {"corrected": True, "tracks": [], "left_out": []})
    write_people(tmp_path / "people.tsv", [])
    write_identities(tmp_path / "identities.tsv", {})
    review.run(
        tmp_path / "a.json",
        tmp_path / "people.tsv",
        tmp_path / "identities.tsv",
        [],
        [],
        tmp_path / "desk.html",
    )
    assert "0 people" in (tmp_path / "desk.html").read_text()
