# SPDX-License-Identifier: Apache-2.0
"""Every network that can be asked elsewhere, brought as files: the whole workflow on folders of bodies, masks, depth,
views and films."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import yaml
from studiorecon.body.model import BodyModel
from studiorecon.body.person_files import read_person
from studiorecon.camera_files.colmap import read_model
from studiorecon.footage.exr import read_depth
from studiorecon.footage.video import read_stack
from studiorecon.geometry import rotations
from studiorecon.keypoints.layouts import LAYOUTS
from studiorecon.scene.camera import Camera
from studiorecon.scene.people import Person, read_people

from tests.workflow.conftest import QUICK, ROOT, House

FOLDERS = {"detect": "bodies", "masks": "masks", "depth": "depth", "views": "views", "enhance": "films"}


def rows_of(camera: Camera, people: list[Person], body: BodyModel) -> dict[str, np.ndarray]:
    """CoMotion's rows of one camera: every person in every frame, in the camera's own frame."""
    turn, rows = camera.camera_from_world[:3, :3], []
    for track, person in enumerate(people, 1):
        for frame in np.flatnonzero(person.valid):
            pose, betas = person.poses[frame].copy(), person.betas
            joints_m = body.keypoints(LAYOUTS["comotion27"].keypoints, pose[None], betas, person.trans[frame][None])[0]
            seen_m = joints_m @ turn.T + camera.camera_from_world[:3, 3]
            pose[:3] = rotations.log(turn @ rotations.exp(pose[:3]))
            pixels, _ = camera.project(joints_m)
            rows.append((track, frame, pose, betas, seen_m[0], pixels, seen_m))
    names = ("id", "frame_idx", "pose", "betas", "trans", "pred_2d", "pred_3d")
    return {
        name: np.array(values, np.float32 if k > 1 else np.int64)
        for k, (name, values) in enumerate(zip(names, zip(*rows)))
    }


@pytest.fixture(scope="module")
def brought(finished: House, tmp_path_factory: pytest.TempPathFactory) -> tuple[House, Path]:
    """A house in which nothing was run, and folders of what networks would have made of its capture elsewhere."""
    folder, done = tmp_path_factory.mktemp("brought"), finished.folder / "results/tiny"
    elsewhere = {section: folder / name for section, name in FOLDERS.items()}
    cameras, body = read_model(done / "cameras"), BodyModel.load(ROOT / "resources/body.npz")
    people = [read_person(done / f"people/{name}.npz") for name in read_people(done / "people/people.tsv")]
    for path in elsewhere.values():
        path.mkdir()
    for camera in cameras:
        np.savez(elsewhere["detect"] / f"{camera.name}.npz", **rows_of(camera, people, body))
        shutil.copy(done / f"masks/{camera.name}.mkv", elsewhere["masks"])
        # Networks do not know metres.
        np.save(elsewhere["depth"] / f"{camera.name}.npy", 0.37 * read_depth(done / f"depth/{camera.name}.exr")[0])
    for film in (*done.glob("views/??.mkv"), *done.glob("render/*.mkv")):
        if "." not in film.stem:
            shutil.copy(film, elsewhere["views" if film.parent.name == "views" else "enhance"])
    shutil.copytree(
        finished.folder, folder / "house", ignore=shutil.ignore_patterns("results", ".snakemake", "logs", "timings")
    )
    house = House(folder / "house", finished.dataset)
    sections = {section: {"source": "precomputed", "precomputed": str(path)} for section, path in elsewhere.items()}
    sections["views"] = {"synthesizer": "precomputed", "precomputed": str(elsewhere["views"])}
    sections["enhance"] = {"enhancer": "precomputed", "precomputed": str(elsewhere["enhance"])}
    return house, Path(house.overlay(**sections))


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_a_film_and_a_page_come_out_of_networks_files(brought: tuple[House, Path], finished: House) -> None:
    house, overlay = brought
    assert not set(QUICK) & {"people", "masks", "enhance"}, "these are as by default"
    house.snakemake("--cores", "2", "--configfile", str(overlay))
    ours, theirs = house.folder / "results/tiny", finished.folder / "results/tiny"
    assert len(read_people(ours / "people/people.tsv")) == 2
    mine, same = ([read_person(home / f"people/{p}.npz") for p in ("p0", "p1")] for home in (ours, theirs))
    apart_m = [[np.linalg.norm(a.trans - b.trans, axis=1)[a.valid & b.valid].mean() for b in same] for a in mine]
    assert max(map(min, apart_m)) < 0.05, "the same two people stand where they stood"
    for camera in read_model(ours / "cameras"):
        depth, before = (read_depth(home / f"depth/{camera.name}.exr")[0] for home in (ours, theirs))
        assert np.median(np.abs(depth - before) / before) < 0.02, "a scale was found for the files"
        shown, before = (read_stack(home / f"masks/{camera.name}.mkv") > 0 for home in (ours, theirs))
        assert (shown == before).mean() > 0.999
    scores = [json.loads((home / "report/metrics.json").read_text()) for home in (ours, theirs)]
    assert scores[0].keys() == scores[1].keys()
    assert "files brought by the user" in (ours / "report/index.html").read_text()
    assert house.plan("--configfile", str(overlay)) == {}


def test_a_shot_that_was_not_enhanced_elsewhere_is_named_before_anything_runs(house: House, tmp_path: Path) -> None:
    (tmp_path / "heldout.mkv").touch()
    overlay = tmp_path / "films.yaml"
    overlay.write_text(yaml.safe_dump({"enhance": {"enhancer": "precomputed", "precomputed": str(tmp_path)}}))
    done = house.snakemake("--dry-run", "--configfile", str(overlay), check=False)
    assert done.returncode != 0
    assert "which has no orbit.mkv or orbit.mp4" in done.stdout
