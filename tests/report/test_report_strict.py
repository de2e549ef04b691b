# SPDX-License-Identifier: Apache-2.0
"""With strict, a run in which any step warned ends with all the warnings as one error."""

from __future__ import annotations

from pathlib import Path

import pytest
from studiorecon.errors import UserError
from studiorecon.report import strict
from studiorecon.scene.files import write_text


def test_warnings_of_all_steps_are_one_error(tmp_path: Path) -> None:
    write_text(tmp_path / "logs/detect/people/cam2.log", "looked\nwarning: camera cam2: nobody was found\n")
    write_text(
        tmp_path / "logs/people/associate.log", "warning: somebody was left out\nwarning: somebody was left out\n"
    )
    with pytest.raises(UserError) as refused:
        strict.run(tmp_path / "index.html", tmp_path / "logs", tmp_path / "strict.txt")
    told = str(refused.value).splitlines()
    assert told[0].startswith("2 warnings, treated as errors (strict)")
    assert told[1:] == [
        "detect.people.cam2: camera cam2: nobody was found",
        "people.associate: somebody was left out",
    ]
    assert not (tmp_path / "strict.txt").exists()


def test_without_warnings_it_passes(tmp_path: Path) -> None:
    write_text(tmp_path / "logs/plates/clean/cam1.log", "a plate of which 99 % were seen; no warning: none\n")
    strict.run(tmp_path / "index.html", tmp_path / "logs", tmp_path / "strict.txt")
    assert (tmp_path / "strict.txt").is_file()
