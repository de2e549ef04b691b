# SPDX-License-Identifier: Apache-2.0
"""Every sentence that tells the user what to do is followed by a test of this folder, or is listed with the reason."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from fnmatch import fnmatchcase
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any

from tests.made.remedies import PACKAGE, sentences_of

# Places whose advice is followed by another test, or where another test brings what is advised and reaches the end.
ELSEWHERE = {
    "camera_files/raw_camera.py check_focal_px": "faults/test_campaign.py "
    "test_a_focal_length_of_no_lens_is_refused_and_one_within_the_named_range_is_taken",
    "body/avatar/binding.py bind ?": "body/test_binding.py test_what_is_no_person_in_the_rest_pose_is_refused_by_name",
    "calibration/from_people.py pose_cameras ?": "calibration/test_calibration_from_people.py "
    "test_cameras_that_share_nobody_are_undetermined",
    "calibration/from_people.py run 4": "calibration/test_calibration_from_people.py "
    "test_cameras_are_found_from_two_people_in_sixty_frames",
    "cameras/calibration_check.py *": "cameras/test_cameras.py "
    "test_a_calibration_that_fits_nothing_is_refused_and_the_right_one_is_used",
    "cameras/refine.py _nothing_agrees": "cameras/test_cameras.py "
    "test_a_calibration_that_fits_nothing_is_refused_and_the_right_one_is_used",
    "keypoints/layout_choice.py choose_layout 4": "remedies/test_keypoints.py test_a_layout_named_as_advised_is_taken",
    "people/association/grouping.py TrackComparison.pairs": "people/test_people_lift.py "
    "test_two_cameras_find_the_same_people_by_them",
    "deliver/motion_files.py c3d": "deliver/test_deliver_motion.py "
    "test_without_ezc3d_a_warning_says_that_trc_has_the_markers",
    "detect/keypoints.py _of_chapters": "detect/test_film_check.py test_chapters_are_compared_as_one_film",
    "detect/keypoints.py _compared 2": "detect/test_film_check.py "
    "test_people_before_frames_are_named_and_read_once_exchanged",
    "plates/clean.py _add_given 1": "plates/test_plates.py test_a_plate_of_another_room_is_refused",
    "views/fitted.py run": "views/test_views_network.py test_a_brought_film_must_fit_the_path",
    "people/associate.py _warn_of_nobody 1": "people/test_people_associate.py "
    "test_nobody_is_an_empty_table_and_it_is_said",
    "people/associate.py _warn_of_nobody 2": "people/test_people_associate.py "
    "test_people_in_two_frames_only_are_nobody_and_it_is_said",
    "people/association/rejected_people.py *": "people/test_people_associate.py "
    "test_whom_two_of_four_cameras_see_is_a_person_and_an_animal_is_left_out",
    "people/association/acceptance.py *": "people/test_people_gaps.py "
    "test_a_return_that_nothing_decides_is_two_names_and_a_question",
    "people/corrected_identities.py *": "people/test_people_corrected.py test_lines_changed_as_advised_make_a_person",
    "people/fit.py fit_person ?": "people/test_people_fit.py test_a_person_changed_as_advised_is_fitted",
    "people/fitting/limbs.py body_scale": "people/test_people_fit.py test_a_person_changed_as_advised_is_fitted",
    "people/lift.py run ?": "people/test_people_lift.py test_a_depth_that_gives_no_metre_is_refused",
    "rig/first_depth.py network_scale": "people/test_people_lift.py test_a_depth_that_gives_no_metre_is_refused",
    "rig/gravity.py check_tilt": "cameras/test_cameras_tilt.py test_people_tell_by_how_much_the_world_leans",
    "plan/budget.py choose_preset": "plan/test_budget.py test_a_network_without_a_price_is_refused",
    "plan/user_inputs.py *": "plan/test_files.py "
    "test_a_photo_of_a_stranger_is_made_into_a_person_and_asks_for_its_network",
    "cli/real_demo.py *": "workflow/test_real_demo.py test_without_the_films_nothing_stays_and_a_sentence_helps",
    "cli/command.py _run_takes ?": "workflow/test_takes.py test_the_command_prints_and_writes_one_table",
    "render/path_file.py path_steps 2": "remedies/test_shots.py test_a_shot_described_as_advised_is_planned",
    "scene/user_files.py not_permitted 2": "remedies/test_folder.py "
    "test_the_command_that_a_closed_file_s_sentence_names_opens_it",
    "rig/metric_scale.py *": "calibration/test_calibration_given_lengths.py "
    "test_heights_that_cannot_be_true_together_and_names_of_nobody_are_refused",
    "cameras/changes.py *": "cameras/test_cameras.py "
    "test_cameras_that_all_moved_by_degrees_are_put_back_where_people_see_them",
}
# Why no test can follow the rest, or what stands for it.
PASSED_ON = "passes on a sentence that is followed where it is made"
FILM = "a film that no encoder here writes: an intact one is read by every test of films"
FIGURE = "a judgement on a whole scene: the advice is other footage, or to look at it"
ROOT_MAY = "a folder that may not be written: tests may run as root, who may"
NOT_FOLLOWED = {
    "window/projects.py enter 2": ROOT_MAY,
    "window/projects.py write_capture_yaml": PASSED_ON,
    "detect/keypoints.py run": PASSED_ON,
    "footage/frames.py _of_one_size": FILM,
    "footage/timing.py read_timing": FILM,
    "background/half.py run": FIGURE,
    "cameras/refine.py decide 3": FIGURE,
    "board/*": FIGURE,
    "calibration/formats/board.py read": FIGURE,
    "depth/fusion.py calibrate_network 1": FIGURE,
    "plates/clean.py run": FIGURE,
    "humans/train.py _crops": FIGURE,
    "render/light.py run": FIGURE,
    "rig/outlier_camera.py warn_of_outlier_cameras 1": FIGURE,
    "rig/world_of_people.py align_to_people.upright": FIGURE,
}
VERBS = (
    "add|analyse|ask|bring|calibrate|check|choose|copy|correct|cut|delete|display|enhance|exchange|export|fit|force|get|"
    "give|install|keep|leave|let|link|lower|make|move|name|number|open|pass|permit|plan|put|raise|read|reconstruct|"
    "remove|rename|render|replace|resize|restore|run|save|score|set|start|take|turn|undistort|use|wait|write"
)
# A verb at the beginning of a clause, what a value must be, or a remedy that is filled in.
INSTRUCTION = re.compile(
    rf"(?:[;:(,] |\bor |\band |^|so )(?:{VERBS})\b|\bmust\b|did you mean|at most|at least|"
    r"\{(?:remedy|cure|help_|instead|meant|example|refusal|lower|without|install_remedy|card.instead|_?(?:AGAIN|ASK|COPY|CURE|EXAMPLE|INSTEAD|REMEDIES)\b)\b"
)


def text(node: ast.expr | None) -> str:
    """A sentence with ``{name}`` for what is filled in."""
    if isinstance(node, ast.Constant):
        return str(node.value)
    if isinstance(node, ast.JoinedStr):
        return "".join(text(value) for value in node.values)
    if isinstance(node, ast.FormattedValue):
        return f"{{{ast.unparse(node.value)}}}"
    if isinstance(node, ast.IfExp):
        return f"{text(node.body)} | {text(node.orelse)}"
    return f"{{{ast.unparse(node)}}}" if node is not None else ""


@cache
def instructions() -> dict[str, str]:
    """Place → sentence of all that instruct."""
    made = (sentence for file in sorted(PACKAGE.rglob("*.py")) for sentence in sentences_of(file))
    return {s.place: text(s.argument) for s in made if INSTRUCTION.search(text(s.argument))}


@cache
def followed() -> set[str]:
    """The places whose advice a row of this folder follows."""
    found: set[str] = set()
    for file in sorted(Path(__file__).parent.glob("test_*.py")):
        if file != Path(__file__):
            module = import_module(f"tests.remedies.{file.stem}")
            tables = [getattr(module, name) for name in ("ROWS", "PLANS", "CALLS") if hasattr(module, name)]
            found |= {place for table in tables for row in (table.items() if isinstance(table, dict) else table)
                      for place in _strings(row)}  # fmt: skip
    return found


def _strings(row: Any) -> Iterator[str]:
    """The texts of a row that look like places."""
    for part in row if isinstance(row, tuple) else (row,):
        if isinstance(part, tuple):
            yield from _strings(part)
        elif isinstance(part, str) and ".py " in part:
            yield part.strip()


def test_every_advice_is_followed_or_listed_with_the_reason() -> None:
    listed = [*ELSEWHERE, *NOT_FOLLOWED]
    left = {
        place: sentence
        for place, sentence in instructions().items()
        if place not in followed() and not any(fnmatchcase(place, pattern) for pattern in listed)
    }
    assert not left, "add a row to a table of tests/remedies that does what the sentence says"
    assert [p for p in listed if not any(fnmatchcase(place, p) for place in instructions())] == [], "no such sentence"


def test_tests_that_follow_advice_elsewhere_exist() -> None:
    for node in ELSEWHERE.values():
        file, _, name = node.partition(" ")
        assert f"def {name}(" in (Path(__file__).parents[1] / file).read_text(encoding="utf-8"), node
