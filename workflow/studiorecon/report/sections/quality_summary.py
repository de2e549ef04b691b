# SPDX-License-Identifier: Apache-2.0
"""The page's first sentence: the quality of the result, its limiting factor, and the most useful improvement."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

_PRESET = "a longer training (preset standard) helps most"


def quality_summary(metrics: Mapping[str, Any]) -> str:
    """One or two sentences on a scene from its metrics.json, about measured values only."""
    pictures = metrics["pictures"].get("enhanced") or metrics["pictures"].get("raw") or {}
    psnr, ssim = _value(pictures, "psnr"), _value(pictures, "ssim")
    joints_mm = metrics["bodies"]["mpjpe_world_mm"]
    joints = "" if joints_mm is None else f"; joints are {joints_mm:.0f} mm off the truth"
    if psnr is None:
        shares = {shot: s["measured"] for shot, s in metrics["coverage"].items() if s.get("measured") is not None}
        shown = "".join(f"{s:.0%} of film {shot} shows measured surfaces. " for shot, s in shares.items())
        remedy = "name one under held_out in capture.yaml"
        return f"{shown}New views were not scored: no camera is held out ({remedy}){joints}."
    ssim_text = "" if ssim is None else f", SSIM {ssim:.2f}"
    limit, remedy = _limit(pictures)
    return f"New views match the held-out cameras at {psnr:.1f} dB PSNR{ssim_text}{joints}. {limit}; {remedy}."


def _limit(pictures: Mapping[str, Any]) -> tuple[str, str]:
    """The main cause of the largest error, and a remedy."""
    seen, unseen, share = (_value(pictures, name) for name in ("psnr_seen", "psnr_unseen", "share_seen"))
    if seen is not None and unseen is not None and share is not None:
        missed, known = (1 - share) * _error(unseen), share * _error(seen)
        if missed > known:
            part = f"{1 - share:.0%} of the room, {unseen:.1f} dB"
            sentence = f"Surfaces that no training camera sees limit the quality ({part})"
            return sentence, "another camera there helps most (studiorecon plan DIR says where)"
    people, room = _value(pictures, "psnr_people"), _value(pictures, "psnr_background")
    if people is not None and room is not None and people < room:
        return f"People limit the quality ({people:.1f} dB; the room {room:.1f} dB)", _PRESET
    if seen is not None and share is not None:
        return f"Surfaces that cameras do see limit the quality ({share:.0%} of the room, {seen:.1f} dB)", _PRESET
    worst = min(
        (
            (found["value"], camera)
            for camera, found in pictures["psnr"]["cameras"].items()
            if found["value"] is not None
        ),
        default=None,
    )
    where = "" if worst is None else f" (worst at {worst[1]}, {worst[0]:.1f} dB)"
    return f"Pictures alone do not show what limits the quality{where}", _PRESET


def _error(psnr_db: float) -> float:
    return 10 ** (-psnr_db / 10)


def _value(pictures: Mapping[str, Any], name: str) -> float | None:
    return pictures.get(name, {}).get("value")
