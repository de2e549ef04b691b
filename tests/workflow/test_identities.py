# SPDX-License-Identifier: Apache-2.0
"""Correcting who is who: a changed line of identities.tsv fits again whom it concerns, and nobody else."""

from __future__ import annotations

import hashlib
import shutil
from pathlib import Path

import pytest
import yaml

from tests.workflow.conftest import House

RESULTS = tuple(f"results/tiny/people/{name}" for name in ("review.html", "p0.npz", "p1.npz"))


@pytest.fixture(scope="module")
def fitted(finished: House, tmp_path_factory: pytest.TempPathFactory) -> House:
    """A house of its own in which everybody was found and fitted; where a house stands is in none of its results."""
    folder = tmp_path_factory.mktemp("identities") / "house"
    shutil.copytree(finished.folder, folder)
    made = House(folder, finished.dataset)
    made.snakemake(*RESULTS, "--cores", "2")
    return made


def people(house: House) -> Path:
    return house.folder / "results/tiny/people"


def corrected(house: House, person: str) -> tuple[str, str]:
    """Options that name a copy of identities.tsv in which the last line of ``person`` is nobody's."""
    lines = (people(house) / "identities.tsv").read_text().splitlines()
    last = max(k for k, line in enumerate(lines) if line.endswith(f"\t{person}"))
    lines[last] = lines[last].removesuffix(person)
    (house.folder / "corrected.tsv").write_text("\n".join(lines) + "\n")
    overlay = house.folder / "corrected.yaml"
    overlay.write_text(yaml.safe_dump({"people": {"identities": "corrected.tsv"}}))
    return "--configfile", str(overlay)


def test_one_changed_line_fits_one_person_again(fitted: House) -> None:
    before = {p: (people(fitted) / f"{p}.npz").stat().st_mtime_ns for p in ("p0", "p1")}
    detected = (people(fitted).parent / "tracks/cam1.npz").stat().st_mtime_ns
    options = corrected(fitted, "p1")
    done = fitted.snakemake(*RESULTS, "--cores", "2", *options)
    after = {p: (people(fitted) / f"{p}.npz").stat().st_mtime_ns for p in ("p0", "p1")}
    assert after["p0"] == before["p0"], done.stdout[-4000:]
    assert after["p1"] > before["p1"], "the corrected person was fitted again"
    assert (people(fitted).parent / "tracks/cam1.npz").stat().st_mtime_ns == detected, (
        "the file's name is no setting of the detections"
    )
    assert "corrected by hand" in (people(fitted) / "review.html").read_text()
    assert "corrected" in (people(fitted) / "people.tsv").read_text()
    assert fitted.plan(*RESULTS, *options) == {}


@pytest.mark.slow
def test_masks_made_again_train_nobody_again_whom_they_show_unchanged(fitted: House) -> None:
    """Masks show everybody, so a correction makes them all again; whose own crops are the same stays as trained, to the
    bit."""
    avatars = [f"results/tiny/humans/p0.{kind}" for kind in ("ply", "npz")]
    quick = fitted.folder / "quick.yaml"
    quick.write_text(yaml.safe_dump({"humans": {"iterations": 5, "gaussians": 500}}))
    options = avatars[0], "--cores", "2", "--configfile", str(quick)
    fitted.snakemake(*options)
    before = [hashlib.sha256((fitted.folder / a).read_bytes()).hexdigest() for a in avatars]
    again = fitted.snakemake(*options, "--forcerun", "masks_segment")
    assert "the existing result is kept" in again.stdout
    assert [hashlib.sha256((fitted.folder / a).read_bytes()).hexdigest() for a in avatars] == before
    assert fitted.plan(*options) == {}
    # Another setting is another result.
    quick.write_text(yaml.safe_dump({"humans": {"iterations": 6, "gaussians": 500}}))
    assert "the existing result is kept" not in fitted.snakemake(*options).stdout
    assert hashlib.sha256((fitted.folder / avatars[0]).read_bytes()).hexdigest() != before[0]


def test_a_correction_that_is_not_there_is_named(fitted: House) -> None:
    overlay = fitted.folder / "missing.yaml"
    overlay.write_text(yaml.safe_dump({"people": {"identities": "nowhere.tsv"}}))
    done = fitted.snakemake("--dry-run", "--configfile", str(overlay), check=False)
    assert done.returncode != 0
    assert "people.identities" in done.stdout
    assert "nowhere.tsv" in done.stdout
