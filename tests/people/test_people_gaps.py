# SPDX-License-Identifier: Apache-2.0
"""Who leaves and returns: joined by way, size and clothes, together over the clip, or two names and a question."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from studiorecon.footage.video import write_lossless
from studiorecon.people import associate
from studiorecon.people.association.acceptance import choose_groups, identities_from_keypoints
from studiorecon.people.corrected_identities import people_table_rows, read_corrected_identities
from studiorecon.scene.camera import Camera
from studiorecon.scene.people import write_identities

from tests.defaults import loaded
from tests.made.cameras import detect, owner, ring, walk

WH, FPS, FRAMES = (320, 176), 15.0, 120
RED, BLUE = (200, 40, 40), (40, 60, 200)


def films(
    cameras: list[Camera], people: list[np.ndarray], colours: list[tuple[int, int, int]], out: Path
) -> list[Path]:
    """Pictures of trunks and limbs in the colours of each person."""
    parts = [(0, 6), (1, 7), (0, 2), (1, 3), (6, 8), (7, 9), (8, 10), (9, 11), (0, 7), (1, 6)]
    paths = []
    for camera in cameras:

        def pictures(camera: Camera = camera):
            for t in range(FRAMES):
                picture = np.full((WH[1], WH[0], 3), 90, np.uint8)
                for points_m, colour in zip(people, colours):
                    pixels = camera.project(points_m[t])[0]
                    for a, b in parts:
                        if np.isfinite(pixels[[a, b]]).all():
                            cv2.line(picture, *(tuple(int(x) for x in pixels[k]) for k in (a, b)), colour, 9)
                yield picture

        paths.append(out / f"{camera.name}.mkv")
        write_lossless(paths[-1], pictures(), FPS)
    return paths


def away(points_m: np.ndarray, first: int, last: int) -> np.ndarray:
    gone = points_m.copy()
    gone[first:last] = np.nan
    return gone


@pytest.mark.parametrize(
    ("colour", "size", "names"),
    [(RED, 1.0, 2), (BLUE, 1.0, 3), (RED, 1.3, 3)],
    ids=["the same clothes", "other clothes", "taller"],
)
def test_who_returns_after_four_seconds_keeps_the_name_where_clothes_and_size_say_so(
    colour, size, names, tmp_path, capsys
):
    cameras, rng = [c.resized(WH) for c in ring()], np.random.default_rng(0)
    stays = walk([-0.5, 0.8, 0], [0.005, 0, 0], FRAMES)
    way = walk([1.2, -0.9, 0], [0, 0.008, 0], FRAMES, 1.0)
    before, after = away(way, 30, FRAMES), away(size * way, 0, 90)
    people = [stays, before, after]
    found = detect(cameras, people, 0.5, rng)
    videos = films(cameras, people, [(60, 160, 60), RED, colour], tmp_path)
    options = loaded(associate.Settings)
    table, rows, _ = identities_from_keypoints(
        options.association, options.triangulation, cameras, found, videos, FRAMES, FPS
    )
    assert len(rows) == names
    whose = {
        p: {table[cameras[v].name, t].person for (v, t), q in owner(cameras, found, people).items() if q == p}
        for p in (1, 2)
    }
    assert (whose[1] == whose[2]) == (names == 2)
    if names == 2:
        assert "is away from 1.9 to 6.0 s and keeps the name by" in capsys.readouterr().out


def test_a_return_that_nothing_decides_is_two_names_and_a_question(tmp_path, capsys):
    """Without pictures, and a size between both: nobody knows."""
    cameras, rng = ring(), np.random.default_rng(0)
    way = walk([1.0, -0.9, 0], [0, 0.008, 0], FRAMES, 1.0)
    people = [walk([-0.5, 0.8, 0], [0.02, 0, 0], FRAMES), away(way, 30, FRAMES), away(1.1 * way, 0, 90)]
    found = detect(cameras, people, 1.0, rng)
    options = loaded(associate.Settings)
    table, rows, _ = identities_from_keypoints(
        options.association, options.triangulation, cameras, found, [], FRAMES, FPS
    )
    assert len(rows) == 3
    reported = capsys.readouterr().out
    assert "p2, seen from 6.0 s on, may be p1, who left at 1.9 s: undecided" in reported
    given = {key: one.person.replace("p2", "p1") for key, one in table.items()}
    write_identities(tmp_path / "identities.tsv", given)
    corrected = read_corrected_identities(tmp_path / "identities.tsv", found)
    assert [row[0] for row in people_table_rows(corrected, found)] == ["p0", "p1"]


def test_groups_that_exclude_each_other_are_chosen_together() -> None:
    assert choose_groups([], {}).tolist() == []
    assert choose_groups([1.0, -1.0], {}).tolist() == [True, False]
    # The best one alone is worth less than the two that it excludes.
    pairs = {(0, 1): -30.0, (0, 2): -30.0}
    assert choose_groups([5.0, 3.0, 3.0], pairs).tolist() == [False, True, True]
    assert choose_groups([7.0, 3.0, 3.0], pairs).tolist() == [True, False, False]
    assert choose_groups([5.0, 4.0], {(1, 0): -3.0}).tolist() == [True, True], "some overlap of two sure people"
