# SPDX-License-Identifier: Apache-2.0
"""Networks, weights and their inputs that lead to a sentence: done as it advises, they are used."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from studiorecon.detector.second_network import second_network
from studiorecon.models import weights
from studiorecon.models.adapters import gen3c
from studiorecon.models.adapters.comotion import Comotion
from studiorecon.models.adapters.gen3c import depth_scale, preprocess
from studiorecon.models.adapters.lhm import preprocess as cut_out
from studiorecon.models.catalogue.checksums import PINS, read_pins
from studiorecon.models.catalogue.preflight import staged_weights
from studiorecon.models.catalogue.registry import MODELS
from studiorecon.recursive.sequence import check_gain
from studiorecon.tracks.bodies import read_bodies, require_used_frames
from studiorecon.views.frame import fit_network_frame

from tests.detect import test_detect_one_stage as one_stage
from tests.detect import test_detect_top_down as top_down
from tests.made.remedies import follow_row
from tests.models.test_gen3c import HW, key_frames, way
from tests.models.test_lhm import standing
from tests.models.test_weights import Hub
from tests.tracks.test_tracks_bodies import rows

Call = Callable[[Path], Any]
TOP, ONE = "detector/top_down.py", "detector/one_stage.py"
LHM, GEN3C = "models/adapters/lhm.py", "models/adapters/gen3c.py"
FETCHED = "fixer/base/tokenizer_fast.pth"


def second(points: int, layout: str = "auto", sides: tuple[Any, Any] = (256, 192)) -> Call:
    return lambda f: second_network([top_down.written(f / "x.onnx", points, False, sides)], layout)


def whole(sides: tuple[Any, Any], points: int = 17) -> Call:
    return lambda f: second_network([one_stage.written(f / "x.onnx", sides, points)], "auto")


def network(content: bytes | None) -> Call:
    def call(folder: Path) -> None:
        if content is not None:
            (folder / "x.onnx").write_bytes(content)
        second_network([folder / "x.onnx"], "auto")

    return call


def photo(**given: int) -> Call:
    return lambda _: cut_out(*standing(**given))


def path_of(length: int, turned: bool = False) -> Call:
    def call(_: Path) -> None:
        frames = key_frames()
        asked = [frames[0].camera] * length if length != 121 else way(frames)
        preprocess(frames, [*asked[1:], frames[1].camera] if turned else asked)

    return call


def staged(damage: Callable[[Path], object], again: Callable[[Path], object]) -> Call:
    """Weights fetched, damaged, and fetched again after what was advised."""

    def call(folder: Path) -> None:
        weights.run(["fixer"], folder, "yes")
        damage(folder)
        again(folder)
        weights.run(["fixer"], folder, "yes")
        staged_weights(MODELS["fixer"], folder)
        read_pins(folder)

    return call


def faked(folder: Path) -> None:
    (folder / FETCHED).write_bytes(b"faked")


def pins_lost(folder: Path) -> None:
    (folder / PINS).write_text("{")


def nothing(_: Path) -> None:
    pass


def bodies(frames: tuple[int, ...] = (0, 2), lacking: str = "", **changed: Any) -> Call:
    def call(folder: Path) -> None:
        held = {k: v for k, v in (rows(list(frames)) | changed).items() if k != lacking}
        np.savez(folder / "a.npz", **held)
        list(require_used_frames(read_bodies(folder / "a.npz", Comotion), 3, "a.npz"))

    return call


GOOD = second(17)
FILM = fit_network_frame
# Where it is said, what is brought, and the same once that was done: every alternative that the sentence names.
ROWS: list[tuple[Any, ...]] = [
    ("machine/onnx_network.py open_network 1", network(None), GOOD),
    ("machine/onnx_network.py open_network 2", network(b"no network"), GOOD),
    (f"{TOP} TopDown.__init__ 1", second(17, "auto", ("height", "width")), GOOD),
    (f"{TOP} network_layout 1", second(17, "halpe26"), second(26, "halpe26"), second(17)),
    (f"{TOP} network_layout 2", second(21), GOOD),
    (f"{TOP} network_layout 3", second(25), second(25, "body_25"), second(25, "body_25b")),
    (f"{ONE} OneStage.__init__ 1", whole((256, 192)), whole((one_stage.EDGE, one_stage.EDGE))),
    (f"{LHM} preprocess 1", photo(top=20, height=0), photo()),
    (f"{LHM} preprocess 2", photo(top=80, height=400), photo()),
    (f"{LHM} preprocess 3", photo(top=100, height=200), photo()),
    (f"{LHM} preprocess 4", photo(top=20, height=320, width=330), photo()),
    (f"{GEN3C} depth_scale", lambda _: depth_scale([np.zeros((3, 3))]), lambda _: depth_scale([np.ones((3, 3))])),
    (f"{GEN3C} order_key_frames", path_of(121, turned=True), path_of(121)),
    (f"{GEN3C} preprocess", path_of(120), path_of(121)),
    ("models/catalogue/checksums.py verify 1", staged(faked, nothing), staged(faked, lambda f: (f / FETCHED).unlink())),
    ("models/catalogue/checksums.py read_pins", staged(pins_lost, nothing),
     staged(pins_lost, lambda f: (f / PINS).unlink())),
    ("models/catalogue/preflight.py staged_weights 1", lambda f: staged_weights(MODELS["fixer"], f),
     staged(nothing, nothing)),
    ("recursive/sequence.py check_gain 1", lambda _: check_gain(1.2, 0.9), lambda _: check_gain(1.0, 0.9)),
    ("recursive/sequence.py check_gain 2", lambda _: check_gain(1.05, 0.9), lambda _: check_gain(1.0, 0.9)),
    ("tracks/bodies.py require_used_frames", bodies((0, 7)), bodies((0, 2))),
    ("tracks/bodies.py read_bodies", bodies(conf=np.full((2, 1), np.nan)), bodies()),
    ("models/adapters/comotion.py read_bodies 1", bodies(lacking="pred_2d"), bodies()),
    ("models/adapters/comotion.py read_bodies 4", bodies(lacking="conf"), bodies()),
    ("views/frame.py fit_network_frame", lambda _: FILM((200, 100), (720, 1280)),
     lambda _: FILM((360, 640), (720, 1280))),
]  # fmt: skip


@pytest.mark.parametrize("row", range(len(ROWS)), ids=[f"{n} {row[0]}" for n, row in enumerate(ROWS)])
def test_what_networks_need_is_given_as_advised(row: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "huggingface_hub", Hub({f.remote: b"fixer" for f in MODELS["fixer"].weights}))
    monkeypatch.setattr(gen3c, "HW", HW)
    follow_row(ROWS[row], tmp_path)
