# SPDX-License-Identifier: Apache-2.0
"""Networks, weights and their inputs that lead to a sentence: done as it advises, they are used."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any
from unittest.mock import MagicMock, patch

import numpy as np
import onnx
import pytest
import torch
from onnx import TensorProto, helper
from studiorecon.deliver import fusion, usd
from studiorecon.detector.blazepose import BlazePose
from studiorecon.detector.movenet import MoveNet
from studiorecon.detector.second_network import second_network
from studiorecon.machine import gpu
from studiorecon.models import weights
from studiorecon.models.adapters import difix, gen3c, pi3
from studiorecon.models.adapters.comotion import Comotion
from studiorecon.models.adapters.gen3c import depth_scale, preprocess
from studiorecon.models.adapters.gen3c_request import Evidence, check_evidence
from studiorecon.models.adapters.lhm import preprocess as cut_out
from studiorecon.models.adapters.lpips import TRUNKS, read_lpips
from studiorecon.models.adapters.onnx_depth import DepthNetwork
from studiorecon.models.catalogue.checksums import PINS, read_pins
from studiorecon.models.catalogue.fetching import fetch
from studiorecon.models.catalogue.preflight import import_upstream, loading, staged_weights, torch_device
from studiorecon.models.catalogue.registry import MODELS
from studiorecon.models.containers import find_engine, instructions
from studiorecon.recursive.sequence import check_gain
from studiorecon.tracks.bodies import read_bodies, require_used_frames
from studiorecon.views.frame import fit_network_frame

from tests.containers.test_images import planted as engine
from tests.detect import test_detect_one_stage as one_stage
from tests.detect import test_detect_top_down as top_down
from tests.made.remedies import follow_row
from tests.made.vgg import random_weights
from tests.models import test_onnx_depth, test_pi3
from tests.models.test_gen3c import HW, key_frames, way
from tests.models.test_lhm import standing
from tests.models.test_weights import Hub
from tests.remedies.test_settings import Plan
from tests.tracks.test_tracks_bodies import rows

Call = Callable[[Path], Any]
TOP, ONE = "detector/top_down.py", "detector/one_stage.py"
LHM, GEN3C = "models/adapters/lhm.py", "models/adapters/gen3c.py"
SECOND, PREFLIGHT = "detector/second_network.py", "models/catalogue/preflight.py"
NO_ROOM = SimpleNamespace(free=1)
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


def staged_code(folder: Path) -> None:
    with patch.object(sys.modules["huggingface_hub"], "shelf", {f.remote: b"fixer" for f in MODELS["difix"].weights}):
        weights.run(["difix"], folder, "yes")
        (folder / "difix/difix_ref/vae/code.py").write_bytes(b"fixer")
        weights.run(["difix"], folder, "yes")
    staged_weights(MODELS["difix"], folder)


def depth_of(value: float) -> Call:
    def call(folder: Path) -> None:
        network = DepthNetwork(test_onnx_depth.written(folder / "x.onnx", {"depth": (1, 28, 42)}, (28, 42)), "mine")
        with patch.object(network, "_run", lambda _: {"depth": np.full((1, 28, 42), value, np.float32)}):
            network.depth(np.zeros((28, 42, 3), np.uint8), None)

    return call


def bodies(frames: tuple[int, ...] = (0, 2), lacking: str = "", **changed: Any) -> Call:
    def call(folder: Path) -> None:
        held = {k: v for k, v in (rows(list(frames)) | changed).items() if k != lacking}
        np.savez(folder / "a.npz", **held)
        list(require_used_frames(read_bodies(folder / "a.npz", Comotion), 3, "a.npz"))

    return call


def given(call: Call, **values: Any) -> Call:
    """The call while targets of the package, with ``__`` for dots, or modules (None: not installed) are replaced."""

    def replaced(folder: Path) -> Any:
        with ExitStack() as stack:
            for name, value in values.items():
                target = name.replace("__", ".")
                is_module = value is None or isinstance(value, ModuleType | MagicMock)
                stack.enter_context(patch.dict(sys.modules, {target: value}) if is_module else patch(target, value))
            return call(folder)

    return replaced


def plan(**settings: Any) -> Call:
    return Plan(settings).made


def answering(kind: int, op: str) -> Call:
    """A network for people's crops of this number type that answers with one operation on the crop."""

    def call(folder: Path) -> None:
        crop = helper.make_tensor_value_info("picture", kind, ["batch", 3, 256, 192])
        answer = helper.make_tensor_value_info("answer", kind, None)
        graph = helper.make_graph([helper.make_node(op, ["picture"], ["answer"])], "stand-in", [crop], [answer])
        made = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 13)], ir_version=8)
        onnx.save(made, folder / "x.onnx")
        second_network([folder / "x.onnx"], "auto")

    return call


def behind_blazepose(layout: str) -> Call:
    second = SimpleNamespace(layout=layout, note="mine")
    return lambda _: BlazePose(DETECTOR / "pose_landmark_full.onnx", second)  # type: ignore[arg-type]


def state(content: Any) -> Call:
    def call(folder: Path) -> None:
        torch.save(content, folder / "x.pt")
        with loading(MODELS["raft"], folder / "x.pt"):
            torch.load(folder / "x.pt", weights_only=True)

    return call


def fetch_one(folder: Path) -> None:
    fetch(replace(MODELS["fixer"].weights[0], size_gb=1.0), folder)


def by_hand(name: str, *more: str) -> Call:
    """The files of a network, put where they belong by hand."""

    def call(folder: Path) -> None:
        for file in (*(file.path for file in MODELS[name].weights), *more):
            (folder / file).parent.mkdir(parents=True, exist_ok=True)
            (folder / file).write_bytes(b"fixer")
        staged_weights(MODELS[name], folder)

    return call


def confidence(*cameras: float) -> Call:
    def call(_: Path) -> None:
        _, _, points, poses = test_pi3.planted(1.0, 3)
        sure = np.stack([np.full(points.shape[1:3], share, np.float32) for share in cameras])
        inset = pi3.Inset(0, 0, test_pi3.WH[1], test_pi3.WH[0])
        kept = len(cameras)
        pi3.postprocess(points[:kept], sure, poses[:kept], [inset] * kept, list("abcd")[:kept], pi3.PI3)

    return call


def lpips(names: tuple[str, ...], hidden: tuple[str, ...] = ()) -> Call:
    def call(folder: Path) -> None:
        held = zip((TRUNKS["alex"].features_file, TRUNKS["alex"].heads_file), random_weights(torch.float32, net="alex"))
        for name, values in held:
            if name in names:
                torch.save(values, folder / name)
        with patch.dict(sys.modules, dict.fromkeys(hidden)):
            read_lpips(folder, 1, "alex", "set the weight to 0")

    return call


def comotion(linked: bool) -> Call:
    """CoMotion with a stand-in of its package, which looks for its files inside of itself as upstream does."""

    def call(folder: Path) -> None:
        by_hand("comotion")(folder / "weights")
        package = folder / "comotion_demo"
        for inner, text in (("models/comotion", STAND_IN), ("utils/smpl_kinematics", "")):
            (package / inner).parent.mkdir(parents=True)
            (package / f"{inner}.py").write_text(text)
        data = package / "data/smpl"
        data.mkdir(parents=True)
        if linked:
            (data / "SMPL_NEUTRAL.pkl").symlink_to(folder / "weights/smpl/SMPL_NEUTRAL.pkl")
        mine = {n: m for n, m in sys.modules.items() if not n.startswith("comotion_demo")}
        with patch.dict(sys.modules, mine, clear=True), patch.object(sys, "path", [str(folder), *sys.path]):
            Comotion(MODELS["comotion"], folder / "weights", "cpu")

    return call


def engines(*names: str) -> Call:
    def call(folder: Path) -> None:
        for name in names:
            engine(folder / "bin", name, "echo 27.0")
        with patch.dict("os.environ", {"PATH": str(folder / "bin")}):
            find_engine()

    return call


def jobs(others: int) -> Call:
    """One more job beside others on a machine with two GPUs."""

    def call(folder: Path) -> None:
        with patch.dict("os.environ", {gpu._VISIBLE: "0,1"}), patch("tempfile.tempdir", str(folder)):
            for _ in range(others + 1):
                gpu._HELD, held = [], gpu._HELD
                gpu.claim_gpu()
                gpu._HELD += held
                os.environ[gpu._VISIBLE] = "0,1"
            for lock in gpu._HELD:
                lock.close()
            gpu._HELD.clear()

    return call


def stored(content: Any, hidden: tuple[str, ...] = ()) -> Call:
    def call(folder: Path) -> None:
        torch.save(content, folder / "a.pt")
        with patch.dict(sys.modules, dict.fromkeys(hidden)):
            read_bodies(folder / "a.pt", Comotion)

    return call


STAND_IN = """from pathlib import Path

assert (Path(__file__).parents[1] / "data/smpl/SMPL_NEUTRAL.pkl").exists()


class CoMotion:
    def __init__(self, **_): ...
    def to(self, _): return self
    def eval(self): ...
"""
DETECTOR = Path(__file__).resolve().parents[2] / "resources/detector"
ALEX = (TRUNKS["alex"].features_file, TRUNKS["alex"].heads_file)
NO_GPU = {"torch__cuda__is_available": lambda: False}
SMALL_GPU = {"torch__cuda__is_available": lambda: True, "torch__cuda__mem_get_info": lambda: (1e9, 1e9)}
LARGE_GPU = SMALL_GPU | {"torch__cuda__mem_get_info": lambda: (1e11, 1e11)}
GREY = np.full((16, 16, 3), 0.5)
TENSORS = {k: torch.from_numpy(v) for k, v in rows([0, 2]).items()}
GOOD = second(17)
FILM = fit_network_frame
ENHANCED = np.full((1, 3, 16, 16), 0.5, np.float32)


def enhanced(made: np.ndarray) -> Call:
    return lambda _: difix.postprocess(made, GREY)


def shown(share: float) -> Call:
    return lambda _: check_evidence(Evidence(0.1, 0.01, 0.5, np.array([share]), np.array([0])))


# Where it is said, what is brought, and the same once that was done: every alternative that the sentence names.
ROWS: list[tuple[Any, ...]] = [
    ("machine/onnx_network.py open_network 1", network(None), GOOD),
    ("machine/onnx_network.py open_network 2", network(b"no network"), GOOD),
    (f"{TOP} TopDown.__init__ 1", second(17, "auto", ("height", "width")), GOOD),
    (f"{TOP} network_layout 1", second(17, "halpe26"), second(26, "halpe26"), second(17)),
    (f"{TOP} network_layout 2", second(21), GOOD),
    (f"{TOP} network_layout 3", second(25), second(25, "body_25"), second(25, "body_25b")),
    (f"{ONE} OneStage.__init__", whole((256, 192)), whole((one_stage.EDGE, one_stage.EDGE))),
    (f"{LHM} preprocess 1", photo(top=20, height=0), photo()),
    (f"{LHM} preprocess 2", photo(top=80, height=400), photo()),
    (f"{LHM} preprocess 3", photo(top=100, height=200), photo()),
    (f"{LHM} preprocess 4", photo(top=20, height=320, width=330), photo()),
    (f"{GEN3C} depth_scale", lambda _: depth_scale([np.zeros((3, 3))]), lambda _: depth_scale([np.ones((3, 3))])),
    (f"{GEN3C} order_key_frames", path_of(121, turned=True), path_of(121)),
    (f"{GEN3C} preprocess", path_of(120), path_of(121)),
    ("models/catalogue/checksums.py read_pins", staged(pins_lost, nothing),
     staged(pins_lost, lambda f: (f / PINS).unlink())),
    ("models/catalogue/preflight.py staged_weights 1", lambda f: staged_weights(MODELS["fixer"], f),
     staged(nothing, nothing)),
    ("recursive/sequence.py check_gain 1", lambda _: check_gain(1.2, 0.9), lambda _: check_gain(1.0, 0.9)),
    ("recursive/sequence.py check_gain 2", lambda _: check_gain(1.05, 0.9), lambda _: check_gain(1.0, 0.9)),
    ("tracks/bodies.py require_used_frames", bodies((0, 7)), bodies((0, 2))),
    ("tracks/bodies.py read_bodies", bodies(conf=np.full((2, 1), np.nan)), bodies()),
    ("models/adapters/comotion.py read_bodies 1", bodies(lacking="pred_2d"), bodies()),
    ("models/adapters/comotion.py read_bodies 5", bodies(lacking="conf"), bodies()),
    (f"{SECOND} second_network", answering(TensorProto.DOUBLE, "Identity"), GOOD),
    (f"{TOP} TopDown.__init__ 2", answering(TensorProto.FLOAT, "Flatten"), GOOD),
    ("detector/blazepose.py BlazePose.__init__ 2", behind_blazepose("smpl24"), behind_blazepose("coco17")),
    ("detector/movenet.py MoveNet.__init__", lambda _: MoveNet(DETECTOR / "pose_landmark_full.onnx"),
     lambda _: MoveNet(DETECTOR / "movenet_multipose.onnx")),
    ("models/adapters/comotion.py read_bodies 2", bodies(pose=np.zeros((2, 71))), bodies()),
    ("models/adapters/comotion.py read_bodies 3", bodies(id=np.array([0.5, 1.0])), bodies()),
    ("models/adapters/comotion.py Comotion.__init__", comotion(linked=False), comotion(linked=True)),
    ("models/adapters/gen3c_request.py check_evidence 3", shown(0.01), shown(0.9),
     plan(survey={"force": {"closed_path": "off"}})),
    ("models/adapters/lpips.py read_lpips 1", lpips(()), lpips(ALEX)),
    ("models/adapters/lpips.py read_lpips 2", lpips(ALEX, ("torch",)), lpips(ALEX)),
    ("models/adapters/onnx_depth.py DepthNetwork._known", depth_of(0.0), depth_of(1.0),
     plan(depth={"source": "embedded"})),
    ("models/adapters/pi3.py postprocess", confidence(0.9, 0.9, 0.9, 0.05), confidence(0.9, 0.9, 0.9)),
    ("models/catalogue/checksums.py other_file", staged(faked, nothing),
     staged(faked, lambda f: (f / FETCHED).unlink())),
    ("models/catalogue/fetching.py fetch 2", lambda f: fetch(MODELS["comotion"].weights[0], f), by_hand("comotion")),
    ("models/catalogue/fetching.py _room_for", given(fetch_one, shutil__disk_usage=lambda _: NO_ROOM), fetch_one),
    ("models/catalogue/fetching.py _client", given(fetch_one, huggingface_hub=None), fetch_one, by_hand("fixer")),
    (f"{PREFLIGHT} staged_weights 2", by_hand("difix", "difix/difix_ref/vae/code.py"), staged_code),
    (f"{PREFLIGHT} import_upstream", lambda _: import_upstream(MODELS["gen3c"], "planted_upstream"),
     given(lambda _: import_upstream(MODELS["gen3c"], "planted_upstream"), planted_upstream=ModuleType("x"))),
    (f"{PREFLIGHT} other_version", enhanced(ENHANCED[:, :2]), enhanced(ENHANCED)),
    (f"{PREFLIGHT} failed", enhanced(ENHANCED * np.nan), plan(enhance={"enhancer": "residual"})),
    (f"{PREFLIGHT} loading", state({"code": Path("x")}), state({"weight": torch.ones(2)})),
    (f"{PREFLIGHT} torch_device 1", given(lambda _: torch_device(MODELS["raft"], "cuda"), **NO_GPU),
     lambda _: torch_device(MODELS["raft"], "cpu"), plan(enhance={"flow": "dis"}),
     given(lambda _: torch_device(MODELS["raft"], "cuda"), **LARGE_GPU)),
    (f"{PREFLIGHT} torch_device 2", given(lambda _: torch_device(MODELS["gen3c"], "cuda"), **SMALL_GPU),
     plan(views={"synthesizer": "warp"}), plan(views={"gen3c": {"offload": True}})),
    ("models/containers.py find_engine", engines(), engines("podman")),
    ("models/containers.py instructions", lambda _: instructions("ADD a b"), lambda _: instructions("COPY a b")),
    ("deliver/fusion.py open3d", given(lambda _: fusion.open3d(), open3d=None),
     given(lambda _: fusion.open3d(), open3d=MagicMock())),
    ("deliver/usd.py pxr", given(lambda _: usd.pxr(), pxr=None), given(lambda _: usd.pxr(), pxr=MagicMock())),
    ("machine/gpu.py claim_gpu", jobs(2), jobs(1)),
    ("tracks/bodies.py _rows 1", stored(TENSORS, ("torch",)), bodies(), stored(TENSORS)),
    ("tracks/bodies.py _rows 2", stored({"id": Path("x")}), bodies(), stored(TENSORS)),
    ("views/frame.py fit_network_frame", lambda _: FILM((200, 100), (720, 1280)),
     lambda _: FILM((360, 640), (720, 1280))),
]  # fmt: skip


@pytest.mark.parametrize("row", range(len(ROWS)), ids=[f"{n} {row[0]}" for n, row in enumerate(ROWS)])
def test_what_networks_need_is_given_as_advised(row: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "huggingface_hub", Hub({f.remote: b"fixer" for f in MODELS["fixer"].weights}))
    monkeypatch.setattr(gen3c, "HW", HW)
    follow_row(ROWS[row], tmp_path)
