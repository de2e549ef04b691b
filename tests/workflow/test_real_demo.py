# SPDX-License-Identifier: Apache-2.0
"""``studiorecon demo --real``: the films come out of a package, whole or not at all, and are looked at."""

from __future__ import annotations

import hashlib
import zipfile
from pathlib import Path

import pytest
from studiorecon.cli import command, real_demo

INFO = "pose2sim-0.10.49.dist-info"
FILES = {"videos/cam01.mp4": b"one", "calibration/Calib.qca.txt": b"two"}


@pytest.fixture
def shop(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder instead of the registry, with a package of that name; the test runs in an empty folder beside it."""
    shop, home = tmp_path / "shop", tmp_path / "home"
    shop.mkdir(), home.mkdir()
    with zipfile.ZipFile(shop / "pose2sim-0.10.49-py3-none-any.whl", "w") as wheel:
        for name, content in FILES.items():
            wheel.writestr(f"Pose2Sim/Demo_SinglePerson/{name}", content)
        wheel.writestr(f"{INFO}/METADATA", "Metadata-Version: 2.1\nName: pose2sim\nVersion: 0.10.49\n")
        wheel.writestr(f"{INFO}/WHEEL", "Wheel-Version: 1.0\nRoot-Is-Purelib: true\nTag: py3-none-any\n")
        wheel.writestr(f"{INFO}/licenses/LICENSE", "BSD 3-Clause")
        wheel.writestr(f"{INFO}/RECORD", "".join(f"{name},,\n" for name in [*wheel.namelist(), f"{INFO}/RECORD"]))
    for name, value in (("PIP_NO_INDEX", "1"), ("UV_OFFLINE", "1"), ("UV_CACHE_DIR", str(tmp_path / "cache"))):
        monkeypatch.setenv(name, value)
    for tool in ("PIP", "UV"):
        monkeypatch.setenv(f"{tool}_FIND_LINKS", str(shop))
    monkeypatch.setattr(
        real_demo, "_FILES", {name: hashlib.sha256(content).hexdigest() for name, content in FILES.items()}
    )
    monkeypatch.chdir(home)
    return shop


def demo(monkeypatch: pytest.MonkeyPatch, *words: str) -> list[tuple[str, str, str]]:
    """What the workflow is started with: goal, capture, preset."""
    calls: list[tuple[str, str, str]] = []
    monkeypatch.setattr(
        command, "_snakemake", lambda goal, dataset, given: calls.append((goal, dataset, given.preset)) or 0
    )
    assert command.main(["demo", "--real", *words]) == (0 if calls else 1)
    return calls


def test_the_films_are_fetched_once_and_looked_at(shop: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert demo(monkeypatch) == [("look", "treadmill", "look")]
    assert {name: Path("treadmill", name).read_bytes() for name in FILES} == FILES
    assert Path("treadmill/LICENSE").read_text() == "BSD 3-Clause"
    assert [path.name for path in Path().iterdir()] == ["treadmill"], "nothing else stays"
    next(shop.iterdir()).unlink()
    assert demo(monkeypatch) == demo(monkeypatch, "treadmill"), "no network, and none needed"


@pytest.mark.parametrize(
    ("fault", "sentence"),
    [("offline", "copy the folder treadmill"), ("other files", "Calib.qca.txt"), ("in use", "remove it")],
)
def test_without_the_films_nothing_stays_and_a_sentence_helps(
    fault: str, sentence: str, shop: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    if fault == "offline":
        next(shop.iterdir()).unlink()
    elif fault == "other files":
        monkeypatch.setitem(real_demo._FILES, "calibration/Calib.qca.txt", "0" * 64)
    else:
        Path("treadmill").write_text("mine")
    before = list(Path().iterdir())
    assert demo(monkeypatch) == []
    assert sentence in capsys.readouterr().err
    assert list(Path().iterdir()) == before
    if fault == "offline":
        Path("treadmill/videos").mkdir(parents=True)
    elif fault == "in use":
        assert demo(monkeypatch, "other"), "another folder"
        Path("treadmill").unlink()
    if fault != "other files":
        assert demo(monkeypatch), "what the sentence says helps"
