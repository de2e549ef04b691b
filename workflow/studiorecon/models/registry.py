# SPDX-License-Identifier: Apache-2.0
"""Every upstream network this workflow can use: what it is for, its licences, its weights, the image it runs in. Data only.

Sizes and checksums are what publishers state; one that nobody here has seen is absent rather than guessed, and whoever stages the weights
pins it. GPU memory comes with who says so. Licences as read in autumn 2026: read the licence itself before relying on one line of a table.
"""

from __future__ import annotations

from studiorecon.models.card import Kind, Memory, Model, Runtime, Terms, WeightFile

_HUB = "Hugging Face"


def _lpips(name: str, title: str, net: str, file: str, weights: str, download: str, size_gb: float) -> Model:
    """LPIPS on one of torchvision's networks, whose download carries the start of its checksum in its name."""
    heads = f"weights/v0.1/{net}.pth"
    return Model(
        name,
        f"LPIPS v0.1 ({title})",
        "perceptual distance",
        Terms("BSD-2-Clause", f"BSD-2-Clause; {title} trained on research data", "yes"),
        (
            WeightFile(
                f"lpips/{file}.pth",
                f"PyTorch model downloads, {download}",
                size_gb=size_gb,
                remote=f"torchvision.models:{weights}",
                how="torchvision",
                sha256=download.removesuffix(".pth").rpartition("-")[2],
            ),
            WeightFile(f"lpips/lpips_{net}.pth", f"package lpips 0.1.4, {heads}", remote=f"lpips:{heads}", how="package"),
        ),
        Runtime("vision", ">=3.10", ">=2.4", (), "lpips 0.1.4"),
        Memory(None, "runs on a CPU; 2 GB on a GPU at 1280×704"),
    )


_TABLE = (
    Model(
        "pi3",
        "Pi3",
        "pose and depth",
        Terms("BSD-3-Clause", "CC BY-NC 4.0", "no", "weights are for non-commercial use", alternative="mapanything"),
        (WeightFile("pi3/model.safetensors", _HUB, "yyfz233/Pi3", 3.83, "model.safetensors"),),
        Runtime("pi3", ">=3.10", "2.5.1", ("torchvision==0.20.1", "numpy==1.26.4", "safetensors", "huggingface_hub"), "9fa3ddb"),
        Memory(8.0, "four to sixteen views of 255 000 pixels; weights 3.7 GB and 53 MB per view (upstream benchmark)"),
    ),
    Model(
        "pi3x",
        "Pi3X",
        "pose and depth",
        Terms("BSD-3-Clause", "CC BY-NC 4.0", "no", "weights are for non-commercial use", alternative="mapanything"),
        (WeightFile("pi3x/model.safetensors", _HUB, "yyfz233/Pi3X", 5.44, "model.safetensors"),),
        Runtime("pi3", ">=3.10", "2.5.1", ("torchvision==0.20.1", "numpy==1.26.4", "safetensors", "huggingface_hub"), "9fa3ddb"),
        Memory(10.0, "four to sixteen views of 255 000 pixels; weights 5.4 GB (upstream benchmark)"),
    ),
    Model(
        "mapanything",
        "MapAnything (Apache weights)",
        "pose and depth",
        Terms("Apache-2.0", "Apache-2.0", "yes"),
        (
            WeightFile("mapanything/model.safetensors", _HUB, "facebook/map-anything-apache", remote="model.safetensors"),
            WeightFile("mapanything/config.json", _HUB, "facebook/map-anything-apache", remote="config.json"),
        ),
        Runtime("mapanything", ">=3.10", ">=2.4", ("safetensors", "huggingface_hub"), "2026-03"),
        Memory(12.0, "four to sixteen views; our estimate, nobody states it"),
    ),
    Model(
        "moge",
        "MoGe-2 (ViT-L, normals)",
        "monocular depth",
        Terms("MIT, DINOv2 part Apache-2.0", "MIT", "yes"),
        (WeightFile("moge/moge-2-vitl-normal.pt", _HUB, "Ruicheng/moge-2-vitl-normal", remote="model.pt"),),
        Runtime("moge", ">=3.10", ">=2.0", ("utils3d at the commit MoGe pins",), "0744441"),
        Memory(6.0, "one picture at a time, ViT-L in half precision; our estimate"),
    ),
    Model(
        "moge3",
        "MoGe-3 (ViT-L)",
        "monocular depth",
        Terms("MIT", "MIT", "yes"),
        (WeightFile("moge/moge-3-vitl.pt", _HUB, "Ruicheng/moge-3-vitl", remote="model.pt"),),
        Runtime("moge3", ">=3.10", ">=2.4", ("utils3d-moge", "FlexGEMM v2"), "2026-08"),
        Memory(8.0, "one picture at a time; our estimate"),
    ),
    Model(
        "sam3",
        "SAM 3",
        "person segmenter",
        Terms(
            "Apache-2.0 (transformers)",
            "SAM License",
            "with conditions",
            "pass the licence on, acknowledge in publications, no military, weapons or espionage use",
        ),
        (
            WeightFile("sam3/model.safetensors", _HUB, "facebook/sam3", 3.4, remote="model.safetensors", gated=True),
            WeightFile("sam3/config.json", _HUB, "facebook/sam3", remote="config.json", gated=True),
            WeightFile("sam3/processor_config.json", _HUB, "facebook/sam3", remote="processor_config.json", gated=True),
            WeightFile("sam3/tokenizer.json", _HUB, "facebook/sam3", remote="tokenizer.json", gated=True),
            WeightFile("sam3/tokenizer_config.json", _HUB, "facebook/sam3", remote="tokenizer_config.json", gated=True),
        ),
        Runtime("sam3", ">=3.10", ">=2.7", ("transformers>=5.23,<6",), "transformers 5.23.0"),
        Memory(16.0, "chunks of 200 frames stored on the CPU; 3000 frames at once ran out of 80 GB (upstream issue 481)"),
    ),
    Model(
        "comotion",
        "CoMotion",
        "body estimator",
        Terms(
            "Apple sample code licence",
            "Apple machine learning research model licence",
            "no",
            "weights are for research; needs SMPL",
            alternative="keypoints, with files of a detector whose terms allow it",
        ),
        (
            WeightFile("comotion/comotion_detection_checkpoint.pt", "Apple, models/comotion/demo_checkpoints.tar.gz", how="hand"),
            WeightFile("comotion/comotion_refine_checkpoint.pt", "Apple, models/comotion/demo_checkpoints.tar.gz", how="hand"),
            WeightFile("smpl/SMPL_NEUTRAL.pkl", "SMPL v1.1.0, by registration with MPI", how="hand", gated=True),
        ),
        Runtime("comotion", "3.10", "2.5.1", ("transformers==4.48.0", "timm==1.0.13", "scenedetect<0.7", "chumpy from git"), "2025-04-15"),
        Memory(6.0, "one 512 pixel frame at a time; our estimate"),
    ),
    Model(
        "smpl",
        "SMPL (smplx)",
        "body model",
        Terms(
            "MPI non-commercial",
            "MPI non-commercial, patented",
            "no",
            "commercial licences through Meshcapade",
            alternative="the bundled body (setting body)",
        ),
        (WeightFile("smpl/SMPL_NEUTRAL.pkl", "SMPL v1.1.0, by registration with MPI", how="hand", gated=True),),
        Runtime("comotion", ">=3.10", ">=2.0", ("smplx==0.1.28",), "0.1.28"),
        Memory(None, "runs on a CPU"),
    ),
    Model(
        "gen3c",
        "GEN3C (Cosmos 7B)",
        "view synthesizer",
        Terms(
            "Apache-2.0",
            "NVIDIA Open Model License",
            "with conditions",
            "the licence has a clause on bypassing guardrails, and GEN3C's own scripts switch its guardrail off",
        ),
        (
            WeightFile(
                "gen3c/Gen3C-Cosmos-7B/model.pt", _HUB, "nvidia/Gen3C-Cosmos-7B", remote="model.pt", md5="38644bf823aa5272acef60cfad8bc0f7"
            ),
            WeightFile(
                "gen3c/Cosmos-Tokenize1-CV8x8x8-720p/encoder.jit", _HUB, "nvidia/Cosmos-Tokenize1-CV8x8x8-720p", remote="encoder.jit"
            ),
            WeightFile(
                "gen3c/Cosmos-Tokenize1-CV8x8x8-720p/decoder.jit", _HUB, "nvidia/Cosmos-Tokenize1-CV8x8x8-720p", remote="decoder.jit"
            ),
            WeightFile(
                "gen3c/Cosmos-Tokenize1-CV8x8x8-720p/mean_std.pt",
                _HUB,
                "nvidia/Cosmos-Tokenize1-CV8x8x8-720p",
                remote="mean_std.pt",
                md5="f07680ad7eefae57d698778e2a0c7c96",
            ),
            WeightFile(
                "gen3c/Cosmos-Tokenize1-CV8x8x8-720p/image_mean_std.pt",
                _HUB,
                "nvidia/Cosmos-Tokenize1-CV8x8x8-720p",
                remote="image_mean_std.pt",
                md5="9f19fd3312fc1198e4905ada02e68bce",
            ),
        ),
        Runtime(
            "gen3c",
            "3.10",
            "2.6.0",
            ("transformer-engine==1.12.0", "megatron-core==0.10.0", "apex", "warp-lang==1.7.2", "transformers==4.49.0", "numpy==1.26.4"),
            "db2ffe1",
        ),
        Memory(48.0, "704×1280, 121 frames, every offload on: 43 GB (upstream issue 33) and 5 GB of warps; without offload 80 GB"),
    ),
    Model(
        "difix",
        "Difix3D+ (difix_ref)",
        "picture enhancer",
        Terms(
            "NVIDIA non-commercial",
            "NVIDIA non-commercial, SD-Turbo licence",
            "no",
            "code and weights are for non-commercial use",
            alternative="fixer",
        ),
        (
            WeightFile("difix/difix_ref/model_index.json", _HUB, "nvidia/difix_ref", remote="model_index.json", how="snapshot"),
            WeightFile(
                "difix/difix_ref/unet/diffusion_pytorch_model.safetensors",
                _HUB,
                "nvidia/difix_ref",
                3.46,
                "unet/diffusion_pytorch_model.safetensors",
            ),
            WeightFile(
                "difix/difix_ref/vae/diffusion_pytorch_model.safetensors",
                _HUB,
                "nvidia/difix_ref",
                0.34,
                "vae/diffusion_pytorch_model.safetensors",
            ),
            WeightFile("difix/difix_ref/text_encoder/model.safetensors", _HUB, "nvidia/difix_ref", remote="text_encoder/model.safetensors"),
        ),
        Runtime(
            "difix",
            ">=3.10",
            ">=2.0",
            ("diffusers==0.25.1", "transformers==4.38.0", "huggingface-hub==0.25.1", "peft==0.9.0", "numpy<2"),
            "c76edc5",
        ),
        Memory(10.0, "1280×704 in half precision; our estimate"),
    ),
    Model(
        "fixer",
        "Fixer",
        "picture enhancer",
        Terms(
            "Apache-2.0",
            "NVIDIA Open Model License",
            "with conditions",
            "the licence has a clause on bypassing guardrails; trained on driving, takes no reference photo",
        ),
        tuple(
            WeightFile(f"fixer/{name}", _HUB, "nvidia/Fixer", remote=name)
            for name in ("pretrained/pretrained_fixer.pkl", "base/model_fast_tokenizer.pt", "base/tokenizer_fast.pth")
        ),
        Runtime("fixer", "3.10", ">=2.6", ("cosmos-predict2",), "2026-07-30"),
        Memory(16.0, "576×1024; our estimate"),
    ),
    Model(
        "raft",
        "RAFT large (torchvision)",
        "flow",
        Terms("BSD-3-Clause", "BSD-3-Clause, trained on research data", "yes"),
        (
            WeightFile(
                "raft/raft_large_C_T_SKHT_V2.pth",
                "PyTorch model downloads, raft_large_C_T_SKHT_V2-ff5fadd5.pth",
                size_gb=0.02,
                remote="torchvision.models.optical_flow:Raft_Large_Weights.C_T_SKHT_V2",
                how="torchvision",
                sha256="ff5fadd5",
            ),
        ),
        Runtime("vision", ">=3.10", ">=2.4", ("torchvision",), "torchvision 0.29.2"),
        Memory(None, "runs on a CPU; on a GPU 1 GB at 1280×704, 5.6 GB at 1920×1080"),
    ),
    _lpips("lpips", "VGG16", "vgg", "vgg16", "VGG16_Weights.IMAGENET1K_V1", "vgg16-397923af.pth", 0.55),
    _lpips("lpips_alex", "AlexNet", "alex", "alexnet", "AlexNet_Weights.IMAGENET1K_V1", "alexnet-owt-7be5be79.pth", 0.24),
    Model(
        "lhm",
        "LHM-1B",
        "canonical avatar",
        Terms(
            "Apache-2.0, vendors MPI's smplx",
            "CC BY-NC 4.0; needs SMPL-X",
            "no",
            "weights are for non-commercial use; SMPL-X needs registration",
            alternative="a trained person of another capture (replace of a shot)",
        ),
        (
            WeightFile("lhm/LHM-1B/model.safetensors", _HUB, "3DAIGC/LHM-1B-HF", remote="model.safetensors"),
            WeightFile("lhm/LHM_prior_model.tar", "LHM's prior models (Sapiens, SAM 2, SMPL-X, faces)", how="hand", gated=True),
        ),
        Runtime(
            "lhm",
            "3.10",
            "2.3.0",
            ("xformers==0.0.26.post1", "numpy==1.23", "gsplat==1.4.0", "pytorch3d", "transformers==4.41.2"),
            "b31e76a",
        ),
        Memory(24.0, "LHM-1B 22 GB, 500M 18 GB, MINI 16 GB (upstream)"),
    ),
)

MODELS: dict[str, Model] = {one.name: one for one in _TABLE}


def model(name: str) -> Model:
    """The entry of ``name``; KeyError, with what there is, when nobody has heard of it."""
    if name not in MODELS:
        raise KeyError(f"no model is called {name!r}; there are {', '.join(MODELS)}")
    return MODELS[name]


def of_kind(kind: Kind) -> list[Model]:
    """All models of one kind, in the order of the table."""
    return [one for one in _TABLE if one.kind == kind]
