# SPDX-License-Identifier: Apache-2.0
"""A capture with names that shells, YAML, HTML and patterns stumble over runs from its videos to its page; names that
could do harm stop before anything runs."""

from __future__ import annotations

import re
import shutil
from dataclasses import replace
from pathlib import Path

import pytest
import yaml

from tests.workflow.conftest import QUICK, House, make_house, over

SCENE = "Übung (1) müde"
CALLED = {"cam1": "cam 1", "cam2": "Küche.links", "cam3": "GX01 (2)", "cam4": "カメラ4", "view1": "hinten @2 + 1"}


def renamed(dataset: Path, called: dict[str, str]) -> None:
    """Every camera of a dataset under another name, in its files' names and in what they hold."""
    texts = [dataset / name for name in ("capture.yaml", "intri.yml", "extri.yml")]
    for path in texts:
        text = path.read_text(encoding="utf-8")
        for old, new in called.items():
            text = (
                text.replace(f"- {old}", f"- {new!r}").replace(f'"{old}"', f'"{new}"').replace(f"_{old}:", f"_{new}:")
            )
        path.write_text(text, encoding="utf-8")
    for path in [*(dataset / "videos").iterdir(), *(dataset / "keypoints").iterdir()]:
        old = next(name for name in called if path.name.startswith(name))
        path.rename(path.with_name(path.name.replace(old, called[old], 1)))


@pytest.fixture
def taken(finished: House, tmp_path: Path) -> House:
    """A house beside a copy of the smallest studio's footage, both in folders with blanks."""
    dataset = tmp_path / "my takes" / SCENE
    shutil.copytree(finished.folder / "results/studio/tiny/dataset", dataset)
    house = make_house(tmp_path / "my house", str(dataset))
    settings = house.folder / "config/config.yaml"
    settings.write_text(yaml.safe_dump(over(yaml.safe_load(settings.read_text()), QUICK), sort_keys=False))
    return house


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_names_of_all_kinds_run_to_the_page_and_back(taken: House) -> None:
    renamed(Path(taken.dataset), CALLED)
    overlay = taken.overlay(render={"shots": {"fahrt-1": {"kind": "orbit", "frames": 4}}})
    taken.snakemake("--cores", "2", "--configfile", overlay)
    results = taken.folder / "results" / SCENE
    page = (results / "report/index.html").read_text(encoding="utf-8")
    assert SCENE in page
    assert CALLED["view1"] in page
    assert (results / "enhance/fahrt-1.mp4").stat().st_size > 0
    assert len((results / "people/people.tsv").read_text().splitlines()) == 3
    assert taken.plan("--configfile", overlay) == {}
    outside = sorted(p.name for p in taken.folder.parent.iterdir())
    assert outside == ["my house", "my takes"], "nothing was written elsewhere"


@pytest.mark.slow
@pytest.mark.parametrize("what", ["camera", "scene"])
@pytest.mark.parametrize("name", ["$(touch x)", "`touch x`", "a&b", "a;touch x", "a{b}", "-rf", "a\nb"])
def test_names_that_could_do_harm_stop_before_anything_runs(taken: House, name: str, what: str) -> None:
    dataset, house = Path(taken.dataset), taken
    if what == "scene":
        house = replace(taken, dataset=str(dataset.rename(dataset.with_name(name))))
    else:
        renamed(dataset, {**{old: old for old in CALLED}, "cam1": name})
    done = house.snakemake("--cores", "2", check=False)
    assert done.returncode != 0
    assert re.search("cannot be used|cannot handle|does not exist", done.stdout), done.stdout
    assert "Traceback" not in done.stdout
    assert not list(taken.folder.rglob("x"))
