# SPDX-License-Identifier: Apache-2.0
"""Missing files that settings name are refused before the first job, and accepted once they exist."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from studiorecon.errors import UserError
from studiorecon.plan.make import make_plan


def orbit(**more: Any) -> dict[str, Any]:
    return {"render": {"shots": {"a": {"kind": "orbit", **more}}}}


NAMED = {
    "body": lambda file: {"body": file},
    "a stand-in": lambda file: orbit(replace={"p0": file}),
    "a camera path": lambda file: {"render": {"shots": {"a": {"kind": "path", "file": file}}}},
    "a reference": lambda file: orbit(reference=file),
    "identities": lambda file: {"people": {"identities": file}},
}


@pytest.mark.parametrize("changed", NAMED.values(), ids=NAMED)
@pytest.mark.parametrize("kind", ["missing", "folder", "dangling"])
def test_a_named_file_that_is_not_there_is_refused(
    configured: Callable[..., dict[str, Any]],
    home: Path,
    tmp_path: Path,
    changed: Callable[[str], dict[str, Any]],
    kind: str,
) -> None:
    file = tmp_path / "named.npz"
    config = configured(**changed(str(file)))
    if kind == "folder":
        file.mkdir()
    if kind == "dangling":
        file.symlink_to("nowhere")
    with pytest.raises(UserError, match=r"named\.npz"):
        make_plan(config, home)
    if kind == "folder":
        file.rmdir()
    file.unlink(missing_ok=True)
    file.touch()
    make_plan(config, home)


@pytest.mark.parametrize("scene", ["studio", "body"])
def test_a_scene_does_not_take_the_folder_of_what_scenes_share(
    configured: Callable[..., dict[str, Any]], home: Path, scene: str
) -> None:
    with pytest.raises(UserError, match="--config scene=NAME"):
        make_plan(configured(scene=scene), home)
    make_plan(configured(scene=f"{scene}1"), home)
