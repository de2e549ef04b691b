# SPDX-License-Identifier: Apache-2.0
"""LHM (Qiu et al., ICCV 2025): a person's Gaussians in a rest pose from one photo.

Upstream is a program with a checkout, a working directory and compiled parts, so the adapter runs its command line and
reads the resulting file. Axes are SMPL-X's, which are SMPL's: x to the body's left, y up, z forward.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from studiorecon.errors import UserError
from studiorecon.models.catalogue.card import HUB, Card, Memory, Runtime, Terms, WeightFile
from studiorecon.models.catalogue.pickles import require_safe_pickles
from studiorecon.models.catalogue.preflight import failed, import_upstream, staged_weights, torch_device
from studiorecon.scene.gaussians import Gaussians

if TYPE_CHECKING:
    from jaxtyping import Bool, Integer

MODEL = "LHM-1B-HF"
# The folder that upstream searches before it would fetch anything.
_PLACE = f"Damo_XR_Lab/{MODEL}"
_REVISION = "92372582f660066b9f1b9513860744357265b3d5"
CARD = Card(
    name="lhm",
    title="LHM-1B",
    kind="canonical avatar",
    terms=Terms(
        code="Apache-2.0, vendors MPI's smplx",
        weights="CC BY-NC 4.0; needs SMPL-X",
        commercial="no",
        condition="non-commercial weights; SMPL-X needs registration",
        alternative="a trained person of another capture (replace of a shot)",
    ),
    weights=(
        WeightFile(
            f"lhm/{_PLACE}/model.safetensors",
            HUB,
            "3DAIGC/LHM-1B-HF",
            6.85,
            "model.safetensors",
            revision=_REVISION,
            sha256="59dc25167d1d72d57fb068445b96e2343ab550b649e9999765200502d03171b9",
        ),
        WeightFile(f"lhm/{_PLACE}/config.json", HUB, "3DAIGC/LHM-1B-HF", remote="config.json", revision=_REVISION),
        *(
            WeightFile(f"lhm/{name}", f"LHM_prior_model.tar of its authors, extracted ({what})", how="hand", gated=True)
            for name, what in (
                ("sapiens/pretrained/checkpoints/sapiens_1b/sapiens_1b_epoch_173_torchscript.pt2", "Sapiens"),
                ("gagatracker/vgghead/vgg_heads_l.trcd", "faces"),
                ("voxel_grid/human_prior_constrain.npz", "the body's surroundings"),
                ("dense_sample_points/1_20000.ply", "points on the body"),
                ("human_model_files/smplx/SMPLX_NEUTRAL.npz", "SMPL-X, by registration with MPI"),
                ("human_model_files/pose_estimate/multiHMR_896_L.pt", "the pose in the photo"),
                ("sam2/sam2.1_hiera_large.pt", "SAM 2, the person's outline"),
            )
        ),
    ),
    runtime=Runtime(
        image="lhm",
        python="3.10",
        torch="2.3.0",
        pins=("xformers==0.0.26.post1", "numpy==1.23", "gsplat==1.4.0", "pytorch3d", "transformers==4.41.2"),
        commit="b31e76a",
    ),
    memory=Memory(24.0, "LHM-1B 22 GB, 500M 18 GB, MINI 16 GB (upstream)"),
    tried="never",
    unchecked="pytorch3d, rasteriser, simple-knn; SMPL-X",
    instead="give it another photo, or use a canonical .ply (a trained person of another capture)",
)
CARDS = (CARD,)


MIN_PX = 300
"""Smallest height of the person in the photo: below it a face is a few pixels."""
# Range of metres from sole to crown of a body in its rest pose, with arms below the head.
_HEIGHTS_M = (1.2, 2.3)


def preprocess(photo: Integer[np.ndarray, "H W 3"], mask: Bool[np.ndarray, "H W"]) -> Integer[np.ndarray, "h w 3"]:
    """Picture of the person alone on white, h ≥ 1.25 w, from a uint8 photo and the person's mask.

    Raises UserError for a person who is cut off by the picture's border, lies or bends, or is too small.
    """
    if photo.dtype != np.uint8 or mask.shape != photo.shape[:2]:
        raise ValueError(
            f"photo is {photo.dtype} {photo.shape}, mask {mask.shape}; expected uint8 (H, W, 3) and (H, W)"
        )
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    if not len(rows):
        raise UserError("the mask is empty; choose another frame")
    top, bottom, left, right = int(rows[0]), int(rows[-1]) + 1, int(columns[0]), int(columns[-1]) + 1
    height, width = bottom - top, right - left
    if top == 0 or left == 0 or bottom == mask.shape[0] or right == mask.shape[1]:
        raise UserError(
            "the person touches the picture's border: LHM needs head and feet; choose another frame or camera"
        )
    if height < MIN_PX:
        raise UserError(
            f"the person is {height} px high and LHM needs {MIN_PX}; raise capture.width, or choose another frame"
        )
    if width >= height:
        raise UserError(f"the person is {width}×{height} px: LHM needs an upright person; choose another frame")
    full_h = round(height * (1 + 2 * 0.05))
    full_w = max(round(full_h / 1.25) - 1, width + 2)
    full_h = max(full_h, round(full_w * 1.25))
    white = np.full((full_h, full_w, 3), 255, np.uint8)
    row, column = (full_h - height) // 2, (full_w - width) // 2
    inside = white[row : row + height, column : column + width]
    inside[mask[top:bottom, left:right]] = photo[top:bottom, left:right][mask[top:bottom, left:right]]
    return white


def postprocess(read: Gaussians) -> Gaussians:
    """The Gaussians of LHM's file in our order of harmonics; raises UserError unless they form a standing person.

    LHM writes higher harmonics coefficient by coefficient, the common layout channel by channel.
    """
    values = (read.means_m, read.quaternions, read.log_scales, read.logit_opacities, read.sh)
    bad = np.any([~np.isfinite(v).reshape(read.count, -1).all(axis=1) for v in values], axis=0)
    if bad.mean() > 0.01:
        raise failed(CARD, f"returned {int(bad.sum())} of {read.count} Gaussians that are no numbers")
    kept = read.take(~bad)
    tall = float(np.ptp(np.percentile(kept.means_m[:, 1], [0.5, 99.5])))
    if not _HEIGHTS_M[0] <= tall <= _HEIGHTS_M[1]:
        raise failed(CARD, f"returned a person {tall:.2f} m high along y")
    bands = kept.sh.shape[1] - 1
    rest = kept.sh[:, 1:].transpose(0, 2, 1).reshape(kept.count, bands, 3)
    return Gaussians(
        kept.means_m,
        kept.quaternions,
        kept.log_scales,
        kept.logit_opacities,
        np.concatenate([kept.sh[:, :1], rest], axis=1),
    )


class Lhm:
    """Upstream's program; satisfies ``CanonicalAvatar``. Weights: ``lhm/``, ``pretrained_models`` of the checkout."""

    def __init__(self, card: Card, weights: Path, where: str) -> None:
        # Upstream creates this folder, but weights that are mounted into an image may be read-only.
        (staged_weights(card, weights) / "lhm/huggingface").mkdir(exist_ok=True)
        # Upstream unpickles bodies, hands and faces unchecked.
        require_safe_pickles(p for p in sorted((weights / "lhm").rglob("*")) if p.suffix in (".pkl", ".npz"))
        module = import_upstream(card, "LHM")
        torch_device(card, where)
        self._checkout = Path(next(iter(module.__path__))).parent

    def avatar(self, photo: Integer[np.ndarray, "H W 3"], mask: Bool[np.ndarray, "H W"]) -> Gaussians:
        """The person's Gaussians; see ``models.protocols.CanonicalAvatar``."""
        import tempfile

        from studiorecon.images.encoded import write_png
        from studiorecon.scene.gaussians_ply import read_ply

        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            write_png(folder / "person.png", preprocess(photo, mask))
            command = command_for(folder / "person.png", folder / "out")
            return postprocess(read_ply(result_file(command, self._checkout, folder / "out")))


def command_for(picture: Path, out: Path) -> list[str]:
    """Upstream's command line for one picture, with all its outputs below ``out``."""
    import sys

    places = [f"{key}={out / key}" for key in ("mesh_dump", "image_dump", "video_dump", "save_tmp_dump")]
    options = [
        "export_mesh=True",
        "motion_seqs_dir=None",
        "motion_img_dir=None",
        "vis_motion=False",
        "motion_img_need_mask=False",
    ]
    return [
        sys.executable,
        "-m",
        "LHM.launch",
        "infer.human_lrm",
        f"model_name={MODEL}",
        f"image_input={picture}",
        *options,
        *places,
    ]


def result_file(command: list[str], checkout: Path, out: Path) -> Path:
    """The one .ply that a finished command wrote; raises UserError, with the command's last line, without one."""
    import subprocess

    environment: dict[str, Any] = {
        **os.environ,
        "PYTHONPATH": os.pathsep.join([str(checkout), os.environ.get("PYTHONPATH", "")]),
    }
    done = subprocess.run(
        command, cwd=checkout, env=environment, text=True, stdout=subprocess.PIPE, stderr=subprocess.STDOUT
    )
    found = sorted(out.rglob("*.ply"))
    if done.returncode or len(found) != 1:
        last = next((line for line in reversed(done.stdout.splitlines()) if line.strip()), "nothing was printed")
        raise failed(CARD, f"made no person of this photo (status {done.returncode}: {last[:200]})")
    return found[0]


ADAPTER = Lhm
