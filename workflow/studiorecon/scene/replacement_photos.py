# SPDX-License-Identifier: Apache-2.0
"""Names of strangers in films: people of a photo who replace a person of the capture."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path

from studiorecon.errors import UserError
from studiorecon.scene.names import check_name

_PHOTOS = (".png", ".jpg", ".jpeg")
_PLAIN = re.compile(r"[A-Za-z0-9_-]+")


def is_photo(source: str) -> bool:
    """Whether a shot's ``replace`` names a photo; otherwise it names a person, a canonical ``.ply`` or nobody."""
    return Path(source).suffix.lower() in _PHOTOS


def stranger_name(photo: str) -> str:
    """The name of the person in a photo: ``stranger_anna`` for ``photos/anna.jpg``; UserError for an unusable one."""
    stem = Path(photo).stem
    if not _PLAIN.fullmatch(stem):
        raise UserError(
            f"replace names {photo}, whose name becomes part of file names: rename it so that only letters, digits, _ "
            "and - come before its suffix"
        )
    return check_name(f"stranger_{stem}", f"the person in {photo}", "rename the photo")


def photos_of_strangers(sources: Iterable[str]) -> dict[str, str]:
    """Stranger → photo for the sources in shots' ``replace``; UserError for two photos with the same name."""
    found: dict[str, str] = {}
    for photo in sources:
        if is_photo(photo) and found.setdefault(stranger_name(photo), photo) != photo:
            raise UserError(
                f"replace names {found[stranger_name(photo)]} and {photo}: rename one, their people share a name"
            )
    return found
