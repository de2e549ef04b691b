# SPDX-License-Identifier: Apache-2.0
"""SMPL's pickle: chumpy arrays without chumpy, sparse regressors, ten shapes of three hundred, and no foreign code."""

from __future__ import annotations

import pickle
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from scipy import sparse
from studiorecon.body.model import BodyModel
from studiorecon.errors import UserError
from studiorecon.models import smpl

PARENTS = [2**32 - 1, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 12, 13, 14, 16, 17, 18, 19, 20, 21]
VERTICES = 6890


class Ch:
    """What chumpy's class leaves in a pickle: a state with the array under ``x``."""

    def __init__(self, x: np.ndarray) -> None:
        self.x = x


@pytest.fixture
def chumpy(monkeypatch: pytest.MonkeyPatch) -> type:
    """``chumpy.ch.Ch`` for writing, gone again before reading."""
    package, inner = ModuleType("chumpy"), ModuleType("chumpy.ch")
    inner.Ch = Ch
    monkeypatch.setitem(sys.modules, "chumpy", package)
    monkeypatch.setitem(sys.modules, "chumpy.ch", inner)
    monkeypatch.setattr(Ch, "__module__", "chumpy.ch")
    return Ch


def entries(wrap: type | None = None) -> dict:
    rng = np.random.default_rng(0)
    weights = rng.random((VERTICES, 24))
    regressor = np.zeros((24, VERTICES))
    regressor[np.arange(24), rng.integers(0, VERTICES, 24)] = 1
    template, shapes = rng.normal(0, 0.5, (VERTICES, 3)), rng.normal(0, 0.01, (VERTICES, 3, 300))
    return {
        "v_template": wrap(template) if wrap else template,
        "shapedirs": wrap(shapes) if wrap else shapes,
        "posedirs": rng.normal(0, 0.001, (VERTICES, 3, 207)),
        "J_regressor": sparse.csc_matrix(regressor),
        "weights": weights / weights.sum(1, keepdims=True),
        "kintree_table": np.array([PARENTS, list(range(24))], dtype=np.int64),
        "f": rng.integers(0, VERTICES, (100, 3)).astype(np.uint32),
        "bs_style": "lbs",
    }


def test_an_official_pickle_becomes_a_body_of_ours(
    tmp_path: Path, chumpy: type, monkeypatch: pytest.MonkeyPatch
) -> None:
    given = entries(chumpy)
    (tmp_path / "SMPL_NEUTRAL.pkl").write_bytes(pickle.dumps(given, protocol=2))
    monkeypatch.setitem(sys.modules, "chumpy", None)
    monkeypatch.setitem(sys.modules, "chumpy.ch", None)
    smpl.run(tmp_path / "SMPL_NEUTRAL.pkl", tmp_path / "body.npz")
    with np.load(tmp_path / "body.npz", allow_pickle=False) as stored:
        np.testing.assert_array_equal(stored["v_template"], given["v_template"].x)
        np.testing.assert_array_equal(stored["shapedirs"], given["shapedirs"].x[..., :10])
        np.testing.assert_array_equal(stored["J_regressor"], given["J_regressor"].toarray())
    body = BodyModel.load(tmp_path / "body.npz")
    rest = body.vertices(np.zeros((1, 72)), np.zeros(10), np.zeros((1, 3)))
    assert rest.shape == (1, VERTICES, 3)
    assert body.identity.startswith("smpl ")


class Evil:
    def __reduce__(self) -> tuple:
        import os

        return os.mkdir, ("owned",)


def test_a_pickle_cannot_run_code(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("evil.pkl").write_bytes(pickle.dumps({**entries(), "v_template": Evil()}))
    with pytest.raises(UserError, match=r"not a pickle of plain or chumpy arrays .*asks for posix\.mkdir|nt\.mkdir"):
        smpl.run(Path("evil.pkl"), Path("body.npz"))
    assert not Path("owned").exists()


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"weights": np.ones((VERTICES, 55))}, r"weights of body .* expected .*SMPL-X is another"),
        ({"shapedirs": np.zeros((VERTICES, 3, 6))}, "10 or more"),
        ({"posedirs": None}, "has no posedirs"),
    ],
)
def test_another_body_is_named(tmp_path: Path, change: dict, sentence: str) -> None:
    given = {k: v for k, v in {**entries(), **change}.items() if v is not None}
    with pytest.raises(UserError, match=sentence):
        smpl.postprocess(given, tmp_path / "x.pkl")


def test_missing_and_broken_files_are_sentences(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="is missing; SMPL needs a registration"):
        smpl.read_pickle(tmp_path / "none.pkl")
    (tmp_path / "x.pkl").write_bytes(b"\x80\x02}q")
    with pytest.raises(UserError, match="not a pickle"):
        smpl.read_pickle(tmp_path / "x.pkl")


@pytest.mark.weights
def test_smplx_and_our_body_move_the_same_vertices(tmp_path: Path) -> None:
    torch = pytest.importorskip("torch", reason="torch is not installed")
    smplx = pytest.importorskip("smplx", reason="smplx is not installed")
    given = entries()
    (tmp_path / "b.pkl").write_bytes(pickle.dumps(given, protocol=2))
    smpl.run(tmp_path / "b.pkl", tmp_path / "body.npz")
    body = BodyModel.load(tmp_path / "body.npz")
    plain = {k: (v.toarray() if sparse.issparse(v) else v) for k, v in given.items()}
    theirs = smplx.SMPL("", data_struct=smplx.utils.Struct(**plain), batch_size=1, num_betas=10)
    rng = np.random.default_rng(1)
    pose, betas, trans = rng.normal(0, 0.3, 72), rng.normal(0, 1, 10), rng.normal(0, 1, 3)
    made = theirs(*(torch.tensor(v[None], dtype=torch.float32) for v in (betas, pose[3:], pose[:3], trans)))
    # SMPL's translation is added after a turn about the pelvis; ours is where the pelvis is.
    pelvis = body.rest_joints(betas)[0]
    ours = body.vertices(pose[None], betas, (trans + pelvis)[None])[0]
    np.testing.assert_allclose(made.vertices.detach().numpy()[0], ours, atol=1e-4)
