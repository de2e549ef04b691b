# SPDX-License-Identifier: Apache-2.0
"""Networks that estimate the keypoints of one person (``detect.network``).

Their files run as they are, after the detector (``detector.second_network``), in ONNX Runtime on a CPU.
"""

from __future__ import annotations

from studiorecon.models.catalogue.card import HUB, Card, Memory, Runtime, Terms, WeightFile

_RTMPOSE = "rtmposev1/onnx_sdk/rtmpose-m_simcc-body7_pt-body7-halpe26_700e-256x192-4d3e73dd_20230605.zip"
_VITPOSE = "JunkyByte/easy_ViTPose/resolve/main/onnx/coco/vitpose-b-coco.onnx"
_RTMO = "RTMO-m/resolve/3aba1280472b98ee2bf663482e27e243038d23fe/onnx/model.onnx"
_UNCHECKED = "networks of the same form ran"


def _card(name: str, title: str, weights: str, file: WeightFile, layout: str) -> Card:
    return Card(
        name=name,
        title=title,
        kind="point detector",
        terms=Terms(code="Apache-2.0", weights=weights, commercial="yes"),
        weights=(file,),
        runtime=Runtime(image="core", python=">=3.11", torch="", pins=("onnxruntime",), commit=layout),
        memory=Memory(None, "runs on a CPU"),
        tried="parts",
        unchecked=_UNCHECKED,
    )


CARDS = (
    _card(
        "rtmpose",
        "RTMPose-m (26 points with feet)",
        "Apache-2.0 (OpenMMLab's project list), trained on research data",
        WeightFile(
            "rtmpose/rtmpose-m-halpe26-256x192.onnx",
            "OpenMMLab's downloads, and the authors' copy on Hugging Face",
            size_gb=0.056,
            remote="end2end.onnx",
            how="mirrors",
            mirrors=(
                f"download.openmmlab.com/mmpose/v1/projects/{_RTMPOSE}",
                f"huggingface.co/Tau-J/RTMPose/resolve/main/{_RTMPOSE}",
            ),
            sha256="26f3a19e61304a600dfb82d1001d41d24343b89fc70a33ffc84657e0b0bf2ecf",
        ),
        "the release of 5 June 2023",
    ),
    _card(
        "vitpose",
        "ViTPose-B (17 points)",
        "Apache-2.0 (ViTPose, converted by easy_ViTPose), trained on research data",
        WeightFile(
            "vitpose/vitpose-b-coco.onnx",
            f"{HUB}, and its mirror",
            size_gb=0.36,
            remote="vitpose-b-coco.onnx",
            how="mirrors",
            mirrors=(f"huggingface.co/{_VITPOSE}", f"hf-mirror.com/{_VITPOSE}"),
            sha256="26e215fd6e27305824f13db0a0d0b597c3c4adf030dd66cbadf2228256f4af25",
        ),
        "easy_ViTPose's conversion of 2024",
    ),
    _card(
        "rtmo",
        "RTMO-m (17 points, whole picture)",
        "Apache-2.0 (RTMO, exported by Xenova), trained on research data",
        WeightFile(
            "rtmo/rtmo-m-640x640.onnx",
            f"{HUB}, and a copy there by way of its mirror",
            size_gb=0.089,
            remote="model.onnx",
            how="mirrors",
            mirrors=(
                f"huggingface.co/Xenova/{_RTMO}",
                "hf-mirror.com/imagent/rtmo-m-onnx/resolve/main/model.onnx",
            ),
            sha256="76d82c45e5c4810baf587ecf2638d15cbf7ed196afb2055e977382532021b59e",
        ),
        "Xenova's export of 2024",
    ),
)
"""Checksums as recorded by people who fetched the files in 2025 and 2026."""
