# SPDX-License-Identifier: Apache-2.0
"""GEN3C (Ren et al. 2025): the input of its multi-view script, the call with a model that stays loaded, and its output.

Its conventions: world-to-camera, OpenCV axes, first pixel's centre at 0, colours in [−1, 1], 704×1280, 120·n + 1 frames
in chunks of 121 that share one frame. The film is seeded only with key frame 0, so the path must start exactly there.
Depth is clipped to [0, 100] and infinite depth becomes a wall at 100: unknown depth is 0 with mask 0.
``models.adapters.gen3c_request`` checks a request before it takes a GPU.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from studiorecon.errors import UserError
from studiorecon.models.adapters.gen3c_request import CHUNK, HW, check_evidence, check_form, evidence
from studiorecon.models.catalogue.card import HUB, Card, Memory, Runtime, Terms, WeightFile
from studiorecon.models.catalogue.preflight import (
    attribute,
    failed,
    import_upstream,
    loading,
    other_version,
    staged_weights,
    torch_device,
)
from studiorecon.models.protocols import KeyFrame
from studiorecon.scene.camera import Camera

if TYPE_CHECKING:
    from jaxtyping import Float, Integer, Shaped

_TOKENIZER, _REVISION = "Cosmos-Tokenize1-CV8x8x8-720p", "b6af495317c76f287a4131e9299936b1533f5f9f"
CARD = Card(
    name="gen3c",
    title="GEN3C (Cosmos 7B)",
    kind="view synthesizer",
    terms=Terms(
        code="Apache-2.0",
        weights="NVIDIA Open Model License",
        commercial="with conditions",
        condition="clause on bypassing guardrails, which GEN3C's own scripts switch off",
    ),
    weights=(
        WeightFile(
            "gen3c/Gen3C-Cosmos-7B/model.pt",
            HUB,
            "nvidia/Gen3C-Cosmos-7B",
            remote="model.pt",
            revision="9bcfdb4f3924f41376daeadf6200826c12a3bf8e",
            md5="38644bf823aa5272acef60cfad8bc0f7",
        ),
        *(
            WeightFile(
                f"gen3c/{_TOKENIZER}/{name}", HUB, f"nvidia/{_TOKENIZER}", remote=name, revision=_REVISION, md5=md5
            )
            for name, md5 in (
                ("encoder.jit", "f5834d03645c379bc0f8ad14b9bc0299"),
                ("decoder.jit", "ff21a63ed817ffdbe4b6841111ec79a8"),
                ("mean_std.pt", "f07680ad7eefae57d698778e2a0c7c96"),
                ("image_mean_std.pt", "9f19fd3312fc1198e4905ada02e68bce"),
            )
        ),
    ),
    runtime=Runtime(
        image="gen3c",
        python="3.10",
        torch="2.6.0",
        pins=(
            "transformer-engine==1.12.0",
            "megatron-core==0.10.0",
            "apex",
            "warp-lang==1.7.2",
            "transformers==4.49.0",
            "numpy==1.26.4",
        ),
        commit="db2ffe1",
    ),
    memory=Memory(
        48.0,
        "704×1280, 121 frames, every offload on: 43 GB (upstream issue 33) and 5 GB of warps; without offload 80 GB",
    ),
    tried="parts",
    unchecked="transformer-engine and apex; 48 GB of GPU memory",
    instead="set views.gen3c.offload to true, or views.synthesizer to warp",
)
CARDS = (CARD,)

_BUFFERS = 2
"""Number of warped key frames that the network reads per chunk; the cache selects those that cover most."""
_NEAR, _FAR = 1.0, 10.0
"""Range of the median depth for which the network's absolute tolerance (0.02 of its unit) and its clip at 100
are made.
"""
_WITHOUT_OFFLOAD_GB = 80.0


def depth_scale(depths: Sequence[Float[np.ndarray, "H W"]]) -> float:
    """Factor that brings the median of all known depths into [1, 10], or 1; raises UserError without known depth."""
    known = np.concatenate([d[np.isfinite(d) & (d > 0)].ravel() for d in depths])
    if not len(known):
        raise UserError(
            "no key frame has a pixel with known depth, so nothing can be warped; give "
            "depth or train with views.synthesizer: warp"
        )
    median = float(np.median(known))
    scale = min(max(1.0, _NEAR / median), _FAR / median)
    farthest = float(known.max()) * scale
    # The clip at 100 would make a wall of everything behind it, so a deep scene is scaled down as a whole.
    return scale if farthest <= 100 else scale * 100 / farthest


def order_key_frames(key_frames: Sequence[KeyFrame], start: Camera) -> list[int]:
    """Indices of the key frames, first the one at the path's start, which alone seeds the film.

    Raises UserError when the path starts at none.
    """
    gaps = [float(np.abs(k.camera.camera_from_world - start.camera_from_world).max()) for k in key_frames]
    first = int(np.argmin(gaps))
    lens = float(np.abs(key_frames[first].camera.intrinsics - start.intrinsics).max())
    if gaps[first] > 1e-6 or lens > 1e-3:
        raise UserError(
            f"the path starts {gaps[first]:.2g} off the nearest key frame "
            f"({key_frames[first].camera.name}; intrinsics {lens:.2g} px), but "
            "GEN3C continues its first key frame and nothing else; start the path at a training camera"
        )
    return [first, *(i for i in range(len(key_frames)) if i != first)]


def preprocess(key_frames: Sequence[KeyFrame], path: Sequence[Camera]) -> dict[str, Shaped[np.ndarray, " ..."]]:
    """The arrays of gen3c_multiview's npz for key frames and a path of cameras, all at 704×1280.

    ``scene_scale`` is ours and ignored there. Raises UserError for a path that is not 120·n + 1 long or does not start
    at a key frame, ValueError for pictures of another size.
    """
    if len(path) < CHUNK or len(path) % (CHUNK - 1) != 1:
        raise UserError(
            f"GEN3C makes 121, 241, 361, … frames, not {len(path)}; set "
            "views.views_per_segment to 120 (the paper) or a multiple"
        )
    for camera in (*(k.camera for k in key_frames), *path):
        if camera.hw != HW:
            raise ValueError(f"camera {camera.name} is {camera.hw}, expected {HW}")
    frames = [key_frames[i] for i in order_key_frames(key_frames, path[0])]
    scale = depth_scale([np.where(k.usable, k.depth_m, 0) for k in frames])
    usable = [k.usable & np.isfinite(k.depth_m) & (k.depth_m > 0) & np.isfinite(k.rgb).all(axis=-1) for k in frames]
    return {
        "images_key_frames": np.stack([_colours(k.rgb) for k in frames]),
        "depth_key_frames": np.stack(
            [np.where(u, k.depth_m, 0).astype(np.float32)[None] * np.float32(scale) for k, u in zip(frames, usable)]
        ),
        "mask_key_frames": np.stack([u.astype(np.float32)[None] for u in usable]),
        "K_key_frames": np.stack([_intrinsics(k.camera) for k in frames]),
        "w2cs_key_frames": np.stack([_pose(k.camera, scale) for k in frames]),
        "w2cs_all": np.stack([_pose(c, scale) for c in path]),
        "Ks_all": np.stack([_intrinsics(c) for c in path]),
        "scene_scale": np.array(scale, np.float64),
    }


def _colours(rgb: np.ndarray) -> np.ndarray:
    if rgb.shape != (*HW, 3):
        raise ValueError(f"key frame has shape {rgb.shape}, expected {(*HW, 3)}")
    return (np.clip(np.nan_to_num(rgb), 0, 1).transpose(2, 0, 1) * 2 - 1).astype(np.float32)


def _intrinsics(camera: Camera) -> np.ndarray:
    """(3, 3) float32 with the first pixel's centre at 0."""
    moved = camera.intrinsics.astype(np.float64).copy()
    moved[:2, 2] -= 0.5
    return moved.astype(np.float32)


def _pose(camera: Camera, scale: float) -> np.ndarray:
    """(4, 4) float32 world-to-camera in the scaled world."""
    pose = camera.camera_from_world.astype(np.float64).copy()
    pose[:3, 3] *= scale
    return pose.astype(np.float32)


def postprocess(film: Integer[np.ndarray, "T 704 1280 3"], frames: int) -> Integer[np.ndarray, "T 704 1280 3"]:
    """The film, unchanged, after checks; raises UserError for another size, or a film without any content."""
    if film.dtype != np.uint8 or film.shape != (frames, *HW, 3):
        raise other_version(CARD, f"returned {film.dtype} of {film.shape}, expected uint8 of {(frames, *HW, 3)}")
    flat = [t for t in range(frames) if film[t, ::16, ::16].max() == film[t, ::16, ::16].min()]
    if flat:
        raise failed(CARD, f"returned a picture of one colour at frame {flat[0]}")
    return film


class Gen3c:
    """The pipeline, loaded once; every request gives one film. Weights: ``gen3c/`` below ``weights``."""

    hw = HW
    # Upstream keeps every key frame's warps of a whole chunk, 6.5 GB of main memory each; the job reserves 64 GB.
    most_key_frames = 8

    def __init__(
        self,
        card: Card,
        weights: Path,
        where: str,
        *,
        steps: int,
        guidance: float,
        seed: int,
        offload: bool,
        filter_points_threshold: float,
        foreground_masking: bool,
    ) -> None:
        folder = staged_weights(card, weights) / "gen3c"
        pipeline = attribute(
            card, import_upstream(card, "cosmos_predict1.diffusion.inference.gen3c_pipeline"), "Gen3cPipeline"
        )
        cache = import_upstream(card, "cosmos_predict1.diffusion.inference.cache_3d")
        self._cache = attribute(card, cache, "Cache3D_BufferSelector")
        self._filters = {"filter_points_threshold": filter_points_threshold, "foreground_masking": foreground_masking}
        self._device = torch_device(card, where, None if offload else _WITHOUT_OFFLOAD_GB)
        # The paper uses no prompts: without the encoder 45 GB of weights are saved. Guardrail and prompt upsampler are
        # off as in GEN3C's own script; the licence's clause on guardrails is on the card.
        with loading(card, folder):
            self._pipeline = pipeline(
                inference_type="video2world",
                checkpoint_dir=str(folder),
                checkpoint_name="Gen3C-Cosmos-7B",
                enable_prompt_upsampler=False,
                offload_network=offload,
                offload_tokenizer=offload,
                offload_text_encoder_model=offload,
                disable_guardrail=True,
                disable_prompt_encoder=True,
                guidance=guidance,
                num_steps=steps,
                height=HW[0],
                width=HW[1],
                fps=24,
                num_video_frames=CHUNK,
                seed=seed,
            )

    @staticmethod
    def request(key_frames: Sequence[KeyFrame], path: Sequence[Camera]) -> dict[str, Shaped[np.ndarray, " ..."]]:
        """The arrays of a request; see ``models.protocols.ViewSynthesizer``."""
        return preprocess(key_frames, path)

    @staticmethod
    def check(request: dict[str, Shaped[np.ndarray, " ..."]]) -> None:
        """Checks a request; see ``models.protocols.ViewSynthesizer``."""
        check_form(request)

    @staticmethod
    def evidence(request: dict[str, Shaped[np.ndarray, " ..."]]) -> str:
        """The check of a request by rendering; see ``models.protocols.ViewSynthesizer``."""
        found = evidence(request)
        check_evidence(found)
        return (
            f"warped onto itself, the first key frame differs by {found.own_error_levels:.2f} levels; key frames "
            f"agree in depth within {found.depth_agreement:.1%} and cover at least {found.coverage.min():.0%} of "
            "every view"
        )

    def views(self, request: dict[str, Shaped[np.ndarray, " ..."]]) -> Iterator[Integer[np.ndarray, "t 704 1280 3"]]:
        """The film in parts (t, 704, 1280, 3) uint8 as they are generated, without the frames that chunks share."""
        cache = warp_cache(partial(self._cache, **self._filters), request, self._device)
        yield from generate_chunks(self._pipeline.generate, cache, request, self._device)


def warp_cache(selector: Any, request: dict[str, Shaped[np.ndarray, " ..."]], where: Any) -> Any:
    """Upstream's 3D cache of a request's key frames on a torch device; ``selector`` knows its filters already."""
    import torch

    def batch(name: str) -> Any:
        return torch.as_tensor(request[name], dtype=torch.float32, device=where)[None]

    return selector(
        frame_buffer_max=_BUFFERS,
        input_image=batch("images_key_frames"),
        input_depth=batch("depth_key_frames"),
        input_mask=batch("mask_key_frames"),
        input_w2c=batch("w2cs_key_frames"),
        input_intrinsics=batch("K_key_frames"),
        input_format=["B", "N", "C", "H", "W"],
        device=where,
    )


def generate_chunks(
    generate: Any, cache: Any, request: dict[str, Shaped[np.ndarray, " ..."]], where: Any
) -> Iterator[Shaped[np.ndarray, " ..."]]:
    """The chunks of upstream's ``generate``: the first is seeded with key frame 0, each other with the frame before
    it."""
    import torch

    poses, lenses = (
        torch.as_tensor(request[name], dtype=torch.float32, device=where)[None] for name in ("w2cs_all", "Ks_all")
    )
    seed = torch.as_tensor(request["images_key_frames"][0], dtype=torch.float32, device=where)[None, :, None]
    for first in range(0, poses.shape[1] - 1, CHUNK - 1):
        with torch.no_grad():
            warped, masks = cache.render_cache(poses[:, first : first + CHUNK], lenses[:, first : first + CHUNK])
            made = generate(
                prompt="", image_path=seed, negative_prompt=None, rendered_warp_images=warped, rendered_warp_masks=masks
            )
        if made is None:
            raise failed(CARD, f"returned no frames {first} to {first + CHUNK - 1}: its guardrail stopped them")
        film = postprocess(np.asarray(made[0]), CHUNK)
        seed = torch.as_tensor(film[-1].transpose(2, 0, 1) / 127.5 - 1, dtype=torch.float32, device=where)[
            None, :, None
        ]
        yield film if first == 0 else film[1:]


ADAPTER = Gen3c
