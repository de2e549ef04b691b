# SPDX-License-Identifier: Apache-2.0
"""How long jobs take side by side: which rule waits for which, and who comes first."""

from __future__ import annotations

import heapq
from collections.abc import Mapping, Sequence

WAITS_FOR: Mapping[str, tuple[str, ...]] = {
    "studio_capture": (),
    "detect_people": ("studio_capture",),
    "detect_keypoints": ("studio_capture", "detect_people"),
    "clocks_offsets": ("detect_keypoints",),
    "capture_frames": ("clocks_offsets",),
    "tracks_keypoints": ("capture_frames",),
    "plates_clean": ("tracks_keypoints",),
    "cameras_refine": ("plates_clean",),
    "cameras_held_out": ("cameras_refine",),
    "depth_sweep": ("cameras_refine",),
    "depth_box": ("depth_sweep",),
    "depth_preview": ("depth_box",),
    "people_first_associate": ("cameras_refine",),
    "people_second_look": ("people_first_associate",),
    "people_associate": ("cameras_refine", "people_second_look"),
    "people_fit": ("people_associate",),
    "people_overlay": ("people_fit",),
    "depth_room": ("depth_box", "people_fit"),
    "depth_refine": ("depth_room",),
    "survey_decide": ("depth_refine", "people_associate"),
    "objects_find": ("people_fit", "survey_decide"),
    "masks_segment": ("objects_find", "people_fit", "survey_decide"),
    "render_light": ("masks_segment", "people_fit"),
    "views_synthesize": ("survey_decide",),
    "background_train": ("survey_decide", "views_synthesize"),
    "humans_train": ("masks_segment",),
    "render_shot": ("background_train", "humans_train", "cameras_held_out", "render_light"),
    "render_shade": ("background_train", "humans_train", "render_light"),
    "enhance_shot": ("render_shot",),
    "enhance_comparison": ("enhance_shot",),
    "report_recognition": ("enhance_shot",),
    "report_evaluate": ("enhance_shot",),
    "deliver_player": ("render_shot", "render_shade"),
    "deliver_scene_glb": ("background_train", "humans_train"),
    "deliver_export": ("enhance_shot",),
    "report_page": ("report_evaluate", "report_recognition", "deliver_export", "deliver_player", "deliver_scene_glb"),
}
"""Rule → the rules all of whose jobs end before it begins; for one that a run lacks, what that one waits for."""


def finished_s(jobs_s: Mapping[str, Sequence[float]], cores: int) -> float:
    """From the first job's start to the last one's end where every job (rule → seconds of its jobs) takes one of
    ``cores``, and of those that may begin the one with most behind it goes first, much as the rules' priorities have it
    (Hu, "Parallel sequencing and assembly line problems", Oper. Res. 9, 1961)."""
    left = {rule: sorted(took) for rule, took in jobs_s.items() if len(took)}
    before = {rule: _before(rule, left) for rule in left}
    behind: dict[str, float] = {}
    for rule in reversed([rule for rule in WAITS_FOR if rule in left]):
        after = [behind[other] for other in behind if rule in before[other]]
        behind[rule] = left[rule][-1] + max(after, default=0.0)
    running: list[tuple[float, str]] = []
    unfinished, now = {rule: len(took) for rule, took in left.items()}, 0.0
    while any(left.values()) or running:
        ready = [rule for rule in left if left[rule] and not any(unfinished[other] for other in before[rule])]
        while ready and len(running) < cores:
            rule = max(ready, key=behind.__getitem__)
            heapq.heappush(running, (now + left[rule].pop(), rule))
            ready = [rule for rule in ready if left[rule]]
        now, rule = heapq.heappop(running)
        unfinished[rule] -= 1
    return now


def _before(rule: str, there: Mapping[str, object]) -> set[str]:
    """The rules of a run that a rule waits for."""
    found: set[str] = set()
    for other in WAITS_FOR[rule]:
        found |= {other} if other in there else _before(other, there)
    return found
