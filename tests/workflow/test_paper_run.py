# SPDX-License-Identifier: Apache-2.0
"""The paper's presets run whole on the smallest studio: once on the embedded back ends, then with every network's files
as if they had been made elsewhere."""

from __future__ import annotations

import itertools
import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from studiorecon.body.model import BodyModel
from studiorecon.body.person_files import read_person
from studiorecon.camera_files.colmap import read_model
from studiorecon.footage.video import read_stack
from studiorecon.geometry import rotations
from studiorecon.keypoints.layouts import LAYOUTS
from studiorecon.report.metrics.truth import read_views

from tests.made.smpl import write_smpl
from tests.workflow.conftest import ROOT, House, make_house
from tests.workflow.planted_networks import plant

PAPER, NETWORKS = (str(ROOT / f"config/presets/{name}.yaml") for name in ("paper", "networks"))
# Nothing but sizes and counts: what would take hours, and pictures of the studio's own size.
SMALL: dict = {
    # The presets of networks compute on a GPU; these runs must end without one.
    "device": "auto",
    "capture": {"width": 240},
    "render": {"width": 240},
    "depth": {"sweep_width": 120, "refine_width": 160},
    "views": {"views_per_segment": 6},
    "background": {"training": {"iterations": 200}},
    "humans": {"iterations": 60, "temporal": {"start": 30, "width": 16}},
}
FILES = {"masks": "masks", "depth": "depth", "views": "views", "enhance": "enhance"}


def comotions_files(house: House, folder: Path) -> None:
    """What CoMotion would say of the studio's people, as its rows are stored: truth, in each camera's own axes."""
    folder.mkdir(parents=True)
    body = BodyModel.load(house.folder / "resources/body.npz")
    people = [read_person(p) for p in sorted((house.folder / "results/studio/tiny/truth/bodies").glob("*.npz"))]
    assert len(people) == 2
    for camera in read_model(house.folder / "results/tiny/cameras"):
        turn, shift = camera.camera_from_world[:3, :3], camera.camera_from_world[:3, 3]
        rows = []
        for number, person in enumerate(people, 1):
            points = body.keypoints(LAYOUTS["comotion27"].keypoints, person.poses, person.betas, person.trans)
            pixels, seen = camera.project(points)[0], points @ turn.T + shift
            poses = person.poses.copy()
            poses[:, :3] = rotations.log(turn @ rotations.exp(poses[:, :3]))
            rows += [
                (number, t, poses[t], person.betas, seen[t, 0], pixels[t], seen[t]) for t in range(len(person.poses))
            ]
        names = ("id", "frame_idx", "pose", "betas", "trans", "pred_2d", "pred_3d")
        np.savez(
            folder / f"{camera.name}.npz",
            **{n: np.array(v, np.float32) for n, v in zip(names, zip(*rows))},
        )


def embedded_run(folder: Path) -> House:
    """A house in which the paper's preset ran on the embedded back ends; ``given`` holds what networks would give."""
    house = make_house(folder / "house", "resources/studio/tiny.yaml")
    house.snakemake("--cores", "2", "--configfile", PAPER, house.overlay(**SMALL))
    given = house.folder / "given"
    comotions_files(house, given / "bodies")
    for stage, folder in FILES.items():
        shutil.copytree(house.folder / "results/tiny" / stage, given / folder)
    return house


def with_stand_ins(house: House, weights: Path, **more: object) -> tuple[str, ...]:
    """Options of the presets, and ``more`` settings, with a stand-in of every network that can have one, in a house
    that ran embedded."""
    given = house.folder / "given"
    plant(house, weights)
    smpl = write_smpl(weights / "smpl/SMPL_NEUTRAL.pkl", BodyModel.load(house.folder / "resources/body.npz"))
    brought = {stage: {"precomputed": str(given / folder)} for stage, folder in FILES.items()}
    stand_ins: dict = {
        "body": str(smpl),
        "weights": str(weights),
        "detect": {"source": "precomputed", "precomputed": str(given / "bodies")},
        "masks": {"source": "precomputed"} | brought["masks"],
        "views": {"synthesizer": "precomputed", "people": "bodies"} | SMALL["views"] | brought["views"],
        "people": {"fit": {"vertices": 200}},
        "background": {"training": {"iterations": 40, "lpips": {"whole": False}}, "refinement": {"views": 6}},
        "humans": {"iterations": 20, "temporal": {"start": 10, "width": 16}, "losses": {"lpips": {"whole": False}}},
    }
    return ("--configfile", PAPER, NETWORKS, house.overlay(**(SMALL | stand_ins | more)))


@pytest.fixture(scope="module")
def ran(tmp_path_factory: pytest.TempPathFactory) -> tuple[House, dict]:
    """Such a house, and its scores."""
    house = embedded_run(tmp_path_factory.mktemp("paper"))
    return house, json.loads((house.folder / "results/tiny/report/metrics.json").read_text())


@pytest.mark.slow
@pytest.mark.timeout(3000)
def test_the_papers_presets_run_whole_on_files_of_every_network(ran: tuple[House, dict]) -> None:
    house, embedded = ran
    results, given = house.folder / "results/tiny", house.folder / "given"
    film = read_stack(results / "render/heldout.mkv")
    brought = {stage: {"precomputed": str(given / folder)} for stage, folder in FILES.items()}
    elsewhere: dict = {
        # The calibration is given: nothing can be lifted by the depth of a network that did not run.
        "body": "resources/body.npz",
        "calibration": {"source": "files"},
        "people": {"association": {"position": "rays"}},
        "detect": {"source": "precomputed", "precomputed": str(given / "bodies")},
        "masks": {"source": "precomputed"} | brought["masks"],
        "depth": {"source": "precomputed", "reference": "planes"} | SMALL["depth"] | brought["depth"],
        "views": {"synthesizer": "precomputed", "people": "bodies"} | SMALL["views"] | brought["views"],
        "enhance": {"enhancer": "precomputed", "flow": "dis"} | brought["enhance"],
        # LPIPS and the refiner are the networks that no files can stand for.
        "background": {"training": {"iterations": 200, "lpips": {"weight": 0.0}}, "refinement": {"views": 0}},
        "humans": SMALL["humans"] | {"losses": {"lpips": {"weight": 0.0}}},
        "report": {"lpips": "none"},
    }
    settings = ("--configfile", PAPER, NETWORKS, house.overlay(**(SMALL | elsewhere)))
    planned = house.plan(*settings)
    assert {"tracks_bodies": 4, "depth_refine": 4}.items() <= planned.items()
    assert "depth_network" not in planned
    messages = house.snakemake("--cores", "2", *settings).stdout
    assert house.plan(*settings) == {}, "nothing is left to do"

    assert {"p0", "p1"} == {p.stem for p in (results / "people").glob("p*.npz")}
    assert messages.count("(s*") == 2, "every person has a size of their own"
    found = json.loads((results / "report/metrics.json").read_text())
    assert found["bodies"]["mpjpe_world_mm"] < 60, "bodies of the network's files are where people were"
    # The enhancer's films came from elsewhere, the room and the people did not.
    np.testing.assert_array_equal(
        read_stack(results / "enhance/heldout.mkv"), read_stack(given / "enhance/heldout.mkv")
    )
    assert (read_stack(results / "render/heldout.mkv") != film).any()
    for scored in (embedded, found):
        assert scored["pictures"]["raw"]["psnr"]["value"] > 12


@pytest.mark.slow
@pytest.mark.timeout(3000)
def test_the_papers_presets_run_whole_with_a_stand_in_of_every_network_that_can_have_one(
    ran: tuple[House, dict], tmp_path: Path
) -> None:
    """Pi3 finds cameras and depth, MoGe lifts people to it, SMPL's file is the body, the refiner and the films go
    through the recursive module with RAFT, and LPIPS is in every loss: with planted answers and random weights. Files
    stand for CoMotion, SAM 3 and GEN3C alone."""
    house, _ = ran
    results = house.folder / "results/tiny"
    render = read_stack(results / "render/heldout.mkv")
    settings = with_stand_ins(house, tmp_path / "weights")
    planned = house.plan(*settings)
    wanted = {"calibration_network": 1, "depth_first": 4, "people_lift": 4, "body_plain": 1}
    wanted |= {"background_half": 1, "background_refined": 1}
    assert wanted.items() <= planned.items()
    messages = house.snakemake("--cores", "2", *settings).stdout
    assert "LPIPS is off" not in messages
    assert "pelvises lifted" in messages
    assert house.plan(*settings) == {}, "nothing is left to do"
    fits = [read_person(path) for path in sorted((results / "people").glob("p*.npz"))]
    assert [person.name for person in fits] == ["p0", "p1"]
    assert all(person.body.startswith("smpl ") for person in fits)
    # Pi3's unit became metres by people's bones, and so did its depth.
    true = {name: view.camera.centre_m for name, view in read_views(house.folder / "results/studio/tiny/truth").items()}
    cameras = read_model(results / "cameras")
    pairs = list(itertools.combinations(cameras, 2))
    apart = [np.linalg.norm(a.centre_m - b.centre_m) for a, b in pairs]
    truly = [np.linalg.norm(true[a.name] - true[b.name]) for a, b in pairs]
    np.testing.assert_allclose(np.divide(apart, truly), 1, atol=0.1)
    found = json.loads((results / "report/metrics.json").read_text())
    for version in ("raw", "enhanced"):
        assert found["pictures"][version]["psnr"]["value"] > 10
        assert found["pictures"][version]["lpips"]["value"] > 0
    assert "pi3" in found["protocol"]
    # What the enhancer made is in the films and in the room that trained on it.
    raw, enhanced = (read_stack(results / f"{kind}/heldout.mkv").astype(float) for kind in ("render", "enhance"))
    warmer = (enhanced - raw).mean((0, 1, 2))
    assert warmer[0] - warmer[2] > 5
    assert (results / "background/refined.mkv").is_file()
    assert raw.shape == render.shape
