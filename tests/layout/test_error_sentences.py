# SPDX-License-Identifier: Apache-2.0
"""The page of refusals says what the code says."""

from __future__ import annotations

import ast

from tests.layout import error_sentences


def test_the_page_is_that_of_the_code() -> None:
    again = "run: python -m tests.layout.error_sentences"
    assert error_sentences.PAGE.read_text(encoding="utf-8") == error_sentences.page(), again


def test_what_stands_for_values_is_named_after_them() -> None:
    def told(code: str) -> str:
        return error_sentences.said(ast.parse(code, mode="eval").body)

    assert told("f'camera {camera} in {path}: {k} is missing; ' f'bring {\", \".join(names)}'") == (
        "camera ‹camera› in ‹file›: ‹number› is missing; bring ‹names›"
    )
    assert told("f'{shown(value)} {self.held_out} {len(x)} {path.name} {a if b else \"c\"}'") == (
        "‹value› ‹held out› ‹number› ‹file› ‹a› / c"
    )
    assert told("'one' + f'{table[key]:.3f}'") == "one‹table›"


def test_every_stage_that_refuses_is_there() -> None:
    page = error_sentences.PAGE.read_text(encoding="utf-8")
    for part in ("plan", "calibration", "keypoints", "footage", "scene", "render"):
        assert f"\n## {part}\n" in page
    assert len(list(error_sentences.sentences())) > 300
