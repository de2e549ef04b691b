# SPDX-License-Identifier: Apache-2.0
"""Every verdict that can be forced acts, and on nothing else: the whole plan with one effect on, against the plan with
all of them off.

Whom association found is given (two people), and that the survey was there, because a plan ends where either must be
asked; every verdict is forced.
"""

from __future__ import annotations

import itertools
import os
import re
import time
from collections.abc import Iterable

import pytest
from studiorecon.scene.decisions import Decision, write_decisions
from studiorecon.scene.people import write_people
from studiorecon.survey.effects import EARLY, EFFECTS

from tests.workflow.conftest import House, make_house

# Off where nothing else is said; somebody must be there for most effects to act on.
PLAIN = dict.fromkeys((effect.name for effect in EFFECTS if effect.acts), "off") | {"people": "on", "closed_path": "on"}
# What has to be on for an effect to have something to act on.
BESIDE = {"closed_path": {"view_synthesis": "on"}}
PEOPLE, DECISIONS = "results/tiny/people/people.tsv", "results/tiny/survey/decisions.json"


# Effects that act within the survey alone, or before it.
WITHIN = {"moving_cameras", "hands"}

Jobs = dict[tuple[str, str], str]


def planned(house: House, *arguments: str) -> Jobs:
    """(rule, log) → options of the step, for every job of a dry run."""
    text = house.snakemake("--dry-run", "--cores", "2", "--printshellcmds", *arguments).stdout
    commands = re.findall(r"^Shell command: python -m studiorecon (\S+) (.*)$", text, re.MULTILINE)
    logs = [re.search(r"--log (\S+)", options) for _, options in commands]
    return {
        (step.replace(".", "_"), log[1] if log else ""): options
        for (step, options), log in zip(commands, logs, strict=True)
    }


def outputs(house: House, *arguments: str) -> list[str]:
    """Files that a dry run would make, in the order in which it would; jobs that have a message do not say theirs."""
    text = house.snakemake("--dry-run", "--cores", "2", *arguments).stdout
    return [name for line in re.findall(r"^    output: (.*)$", text, re.MULTILINE) for name in line.split(", ")]


def made(house: House, names: Iterable[str]) -> None:
    """The files and folders, empty, each younger than the one before."""
    for name in names:
        path = house.folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        if path.suffix:
            path.touch()
        else:
            path.mkdir(exist_ok=True)
        moment = next(_MOMENTS)
        os.utime(path, (moment, moment))


_MOMENTS = itertools.count(int(time.time()) - 10**6)


def force(house: House, **verdicts: str) -> list[str]:
    return ["--configfile", house.overlay(survey={"force": PLAIN | verdicts})]


@pytest.fixture(scope="module")
def surveyed(tmp_path_factory: pytest.TempPathFactory) -> House:
    """A house in which two people are known and the scene is surveyed, as if everything before had run."""
    house = make_house(tmp_path_factory.mktemp("surveyed") / "house", "resources/studio/tiny.yaml")
    # A checkout's files are as young as the checkout; what is made from them here is younger.
    for path in house.folder.rglob("*"):
        os.utime(path, (next(_MOMENTS),) * 2)
    folder = "results/tiny/people"
    made(house, [*outputs(house, PEOPLE), f"{folder}/identities.tsv", f"{folder}/association.json", f"{folder}/who"])
    made(house, [f"{folder}/who/{name}" for name in ("p0.tsv", "p1.tsv", "readouts.json")])
    write_people(house.folder / PEOPLE, [(p, 9, "cam1,cam2", 1.0, "keypoints") for p in ("p0", "p1")])
    made(house, [PEOPLE])
    made(house, outputs(house, DECISIONS, *force(house)))
    made(house, [DECISIONS, *(f"results/tiny/survey/{e.artefact.file}" for e in EARLY if e.artefact)])
    closed = Decision("closed_path", "widest gap", 180.0, (170.0, 190.0), 150.0, "off", "open", detail={"widest": "01"})
    write_decisions(house.folder / DECISIONS, [closed])
    made(house, [DECISIONS])
    return house


@pytest.fixture(scope="module")
def plain(surveyed: House) -> Jobs:
    return planned(surveyed, *force(surveyed))


@pytest.mark.parametrize("effect", PLAIN)
def test_a_forced_effect_adds_jobs_or_changes_some(surveyed: House, plain: Jobs, effect: str) -> None:
    beside = BESIDE.get(effect, {})
    first = planned(surveyed, *force(surveyed, **beside)) if beside else plain
    other = "on" if PLAIN[effect] == "off" else "off"
    second = planned(surveyed, *force(surveyed, **beside, **{effect: other}))
    on, off = (second, first) if other == "on" else (first, second)
    assert off.keys() <= on.keys(), "what is not called for is left out, and nothing takes its place"
    changed = on.keys() - off.keys() | {job for job in on.keys() & off.keys() if on[job] != off[job]}
    rules = {rule for rule, _ in changed} - {"report_page"}
    assert bool(rules) != (effect in WITHIN), "the page shows the configuration, whatever is forced"
    assert "capture_frames" not in rules, "no effect films anew"
    if effect == "closed_path":
        assert [log for _, log in on.keys() - off.keys()] == ["logs/tiny/views/01.log"], "the widest gap alone"
