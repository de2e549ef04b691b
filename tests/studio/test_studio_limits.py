# SPDX-License-Identifier: Apache-2.0
"""A studio's description asks for no more than a machine can draw."""

from __future__ import annotations

from pathlib import Path

import pytest
from studiorecon.errors import UserError
from studiorecon.studio.description import read_description


@pytest.mark.parametrize(
    ("text", "mended"),
    [
        ("size: [40000, 25000]", "size: [4000, 2500]\nsupersampling: 1"),
        ("size: [8192, 8192]\nsupersampling: 8", "size: [1024, 1024]\nsupersampling: 8"),
        ("size: [31, 64]", "size: [32, 64]"),
        ("people: 04", "people: 4"),
        ("frames: 10\nframes: 20", "frames: 20"),
    ],
)
def test_what_cannot_be_drawn_is_refused(tmp_path: Path, text: str, mended: str) -> None:
    file = tmp_path / "mine.yaml"
    file.write_text(text)
    with pytest.raises(UserError, match=r"mine\.yaml"):
        read_description(file)
    file.write_text(mended)
    read_description(file)
