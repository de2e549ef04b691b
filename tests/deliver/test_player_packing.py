# SPDX-License-Identifier: Apache-2.0
"""The player's data can be read back within the precision of a picture, whatever the scene; without a browser."""

from __future__ import annotations

import base64
import gzip
import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from studiorecon.body.avatar.avatar_files import Avatar
from studiorecon.body.avatar.posing import Posing
from studiorecon.body.skinning import forward_kinematics
from studiorecon.deliver import player, player_data
from studiorecon.deliver.packing import Bytes, morton_order, quantise_weights
from studiorecon.deliver.player_data import describe_scene
from studiorecon.deliver.player_motion import motion_times
from studiorecon.footage.video import write_lossless
from studiorecon.geometry import rotations
from studiorecon.scene.factors import NONE

from tests.made.player import drawn, scene_of, shade_for, write_page


def unpacked(data: bytes, described: dict) -> np.ndarray:
    """The arrays of the page's reader: (N, C) float64 of ``Bytes.levels``, uint64 of ``whole``, float32 of
    ``floats``.
    """
    count, columns = described["count"], described["columns"]
    if described["packed"] == "floats":
        return np.frombuffer(data, "<f4", count * columns, described["at"]).reshape(count, columns)
    bits = described["bits"]
    raw = np.frombuffer(data, np.uint8, count * columns * bits // 8, described["at"])
    planes = raw.reshape(columns, bits // 8, count).astype(np.uint64)
    values = np.zeros((columns, count), np.uint64)
    for k in range(bits // 8):
        values = (values << np.uint64(8)) | planes[:, k]
    if "low" not in described:
        return values.T
    low, high = np.array(described["low"]), np.array(described["high"])
    return low + (high - low) * (values.T / ((1 << bits) - 1))


def unpacked_quaternions(data: bytes, described: dict) -> np.ndarray:
    """(N, 4) unit quaternions of ``Bytes.quaternions``."""
    packed = unpacked(data, described)[:, 0]
    largest = (packed >> np.uint64(30)).astype(int)
    found = np.zeros((len(packed), 4))
    for k in range(3):
        part = (packed >> np.uint64(10 * (2 - k))) & np.uint64(1023)
        found[np.arange(len(found)), (largest + 1 + k) % 4] = (part / 1022 - 0.5) * np.sqrt(2)
    rest = np.sqrt(np.maximum(0, 1 - np.square(found).sum(axis=1)))
    found[np.arange(len(found)), largest] = rest
    return found


def back(held: Bytes, reported: dict) -> np.ndarray:
    return unpacked(bytes(held.data), reported)


def test_numbers_come_back_within_half_a_step() -> None:
    rng = np.random.default_rng(0)
    held, values = Bytes(), rng.normal(size=(1000, 3)) * [1, 10, 0]
    for bits in (8, 16, 24):
        reported = held.levels(values, bits)
        off = np.abs(back(held, reported) - values)
        assert (off <= 0.5 * np.ptp(values, axis=0) / (2**bits - 1) + 1e-12).all()
    whole = rng.integers(0, 2**24, (50, 2))
    assert (back(held, held.whole(whole, 24)) == whole).all()
    assert (back(held, held.floats(values)) == values.astype(np.float32)).all()
    assert back(held, held.levels(np.zeros((0, 3)), 16)).shape == (0, 3)


def test_turns_come_back_within_a_fifth_of_a_degree() -> None:
    given = np.concatenate([np.random.default_rng(1).normal(size=(2000, 4)), np.eye(4), -np.eye(4), np.zeros((1, 4))])
    held = Bytes()
    reported = held.quaternions(given)
    kept = unpacked_quaternions(bytes(held.data), reported)
    apart = rotations.angle(rotations.from_quaternion(given), rotations.from_quaternion(kept))
    assert np.degrees(apart).max() < 0.2


def test_shares_add_up_to_one_exactly_so_that_nobody_is_pulled_to_the_origin() -> None:
    rng = np.random.default_rng(2)
    weights = rng.dirichlet([0.5] * 4, 5000)
    shares = quantise_weights(weights)
    assert (shares.sum(axis=1, dtype=int) == 255).all()
    assert np.abs(shares / 255 - weights).max() <= 1 / 255
    # A person six metres from the origin whose bones differ by some centimetres stays where they are.
    bones = np.tile(np.arange(4, dtype=np.uint8), (5000, 1))
    moved = np.tile(np.eye(4), (24, 1, 1))
    moved[:, :3, 3] = rng.normal([6, -6, 1], 0.05, (24, 3))
    zeros, unit, sh = (
        np.zeros((5000, 3), np.float32),
        np.ones((5000, 4), np.float32),
        np.zeros((5000, 1, 3), np.float32),
    )
    exact = Posing(bones, weights).out(zeros, unit, sh, moved)[0]
    kept = Posing(bones, shares / np.float32(255)).out(zeros, unit, sh, moved)[0]
    assert np.abs(kept - exact).max() < 0.001


def test_neighbours_on_the_curve_are_near() -> None:
    points = np.random.default_rng(3).uniform(-3, 3, (4000, 3))
    order = morton_order(points)
    assert sorted(order) == list(range(4000))
    steps = np.linalg.norm(np.diff(points[order], axis=0), axis=1)
    assert np.median(steps) < 0.25 * np.median(np.linalg.norm(np.diff(points, axis=0), axis=1))


def reported_of(page: Path) -> tuple[dict, bytes]:
    text = page.read_text(encoding="utf-8")
    held = re.search(r'id="bytes">([^<]*)<', text).group(1)
    return json.loads(re.search(r'id="scene">([^<]*)<', text).group(1)), gzip.decompress(base64.b64decode(held))


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    scene = scene_of(people=2, frames=5)
    return write_page(tmp_path_factory.mktemp("page") / "player.html", scene, NONE, shade_for(scene))


def test_gaussians_stay_where_they_were_to_a_tenth_of_a_millimetre(page: Path) -> None:
    scene, (reported, data) = scene_of(people=2, frames=5), reported_of(page)
    owners = [(scene.room, scene.provenance), *((p.gaussians, p.provenance) for p in scene.people)]
    for entry, (own, marks) in zip(reported["sets"], owners):
        order = morton_order(own.means_m)
        assert np.abs(unpacked(data, entry["means"]) - own.means_m[order]).max() < 1e-4
        assert np.abs(unpacked(data, entry["colours"]) - own.sh[order, 0]).max() < 1e-3
        alpha = 1 / (1 + np.exp(-own.logit_opacities[order].astype(np.float64)))
        assert np.abs(unpacked(data, entry["opacities"])[:, 0] - alpha).max() < 1e-4
        assert (unpacked(data, entry["provenance"])[:, 0] == marks[order]).all()


def joints_read_back(entry: dict, data: bytes, count: int) -> np.ndarray:
    motion = entry["motion"]
    turns = rotations.from_quaternion(unpacked(data, motion["turns"]).reshape(count, 24, 4))
    rest = unpacked(data, motion["rest"]).astype(np.float64)
    joints_m = forward_kinematics(turns, rest, np.array(motion["parents"]))[1]
    return joints_m + unpacked(data, motion["places"])[:, None]


def test_joints_move_as_the_body_model_says_to_half_a_millimetre(page: Path) -> None:
    scene, (reported, data) = scene_of(people=2, frames=5), reported_of(page)
    for person, entry in zip(scene.people, reported["sets"][1:]):
        exact = np.stack([person.joints_m(frame) for frame in range(5)])
        assert np.abs(joints_read_back(entry, data, 5) - exact).max() < 5e-4


def longer(person: Avatar, frames: int) -> Avatar:
    again = np.arange(frames) % len(person.poses)
    arrays = {name: getattr(person, name)[again] for name in ("poses", "trans", "valid", "present")}
    return replace(person, **arrays)


def test_long_motion_is_reported_at_fewer_moments_and_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(player_data, "MOTION_BYTES", 30_000)
    short = scene_of(people=2, frames=4, things=False)
    people = [longer(replace(person, network=None), 600) for person in short.people]
    scene = replace(short, capture=replace(short.capture, frames=600), people=people)
    reported, sentences = describe_scene(scene, Bytes(), NONE)
    assert reported["moments"] == 30_000 // (2 * (24 * 8 + 12))
    assert any(
        f"motion is sampled at {reported['moments']} moments of 600 frames" in sentence for sentence in sentences
    )
    assert motion_times(600, 7)[[0, -1]].tolist() == [0, 599]


def test_a_network_without_places_of_its_own_is_evaluated_at_some() -> None:
    scene = scene_of(people=1, frames=4, things=False)
    assert scene.people[0].network is not None
    person = replace(scene.people[0], network=replace(scene.people[0].network, control=None))
    _, sentences = describe_scene(replace(scene, people=[person]), Bytes(), NONE)
    reported = next(sentence for sentence in sentences if "colours of p0" in sentence)
    assert "4 moments and 512 places" in reported
    assert float(re.search(r"within ([\d.]+) %", reported).group(1)) < 60


def test_a_shadow_lies_on_the_same_gaussians(page: Path) -> None:
    scene, (reported, data) = scene_of(people=2, frames=5), reported_of(page)
    entry, shade = reported["sets"][0]["shade"], shade_for(scene)
    at = unpacked(data, entry["at"])[:, 0].astype(int)
    order = morton_order(scene.room.means_m)
    factors = unpacked(data, entry["factors"]).reshape(5, len(at))
    assert set(order[at]) <= set(shade.at)
    column = {index: k for k, index in enumerate(shade.at)}
    exact = shade.factors[:, [column[index] for index in order[at]]]
    assert np.abs(factors - exact).max() < 0.004


def test_names_stay_text_and_nothing_is_requested_from_a_network(tmp_path: Path) -> None:
    scene = replace(scene_of(people=0, frames=2, things=False), name="</script><b>x</b>")
    text = write_page(tmp_path / "player.html", scene).read_text(encoding="utf-8")
    assert "<b>x</b>" not in text
    assert reported_of(tmp_path / "player.html")[0]["scene"] == "</script><b>x</b>"
    assert not re.search(r'(src|href)="(?!data:)|@import|url\(|https?://', text)


def test_what_cameras_filmed_is_a_film_or_some_photos(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = scene_of(people=0, frames=20, things=False)
    videos = [tmp_path / f"{camera.name}.mkv" for camera in scene.cameras]
    picture = (255 * np.clip(drawn(scene, scene.cameras[0], 0), 0, 1)).astype(np.uint8)
    for video in videos:
        write_lossless(video, [picture] * 20, 15.0)
    held = Bytes()
    cameras: list[dict] = [{} for _ in videos]
    assert player.add_footage(held, cameras, videos, 20, 15.0) == []
    film = cameras[1]["film"]
    assert film["packed"] == "file"
    assert bytes(held.data)[film["at"] + 4 : film["at"] + 8] == b"ftyp"
    monkeypatch.setattr(player, "FILM_FRAMES", 10)
    cameras = [{} for _ in videos]
    reported = player.add_footage(held, cameras, videos, 20, 15.0)
    assert "8 of 20 photos" in reported[0]
    assert [photo["frame"] for photo in cameras[0]["photos"]][:: len(cameras[0]["photos"]) - 1] == [0, 19]


def test_the_page_knows_when_somebody_is_away(tmp_path: Path) -> None:
    scene = scene_of(people=2, frames=5)
    late = replace(scene.people[1], present=np.array([False, False, True, True, False]))
    page = write_page(tmp_path / "player.html", replace(scene, people=[scene.people[0], late]))
    reported, data = reported_of(page)
    always, gone = (entry["motion"] for entry in reported["sets"] if entry["kind"] == "person")
    assert "present" not in always
    assert unpacked(data, gone["present"]).ravel().tolist() == [0, 0, 1, 1, 0]
