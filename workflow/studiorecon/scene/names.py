# SPDX-License-Identifier: Apache-2.0
"""Names of cameras and scenes, which become folders, wildcards and columns: what they may consist of."""

from __future__ import annotations

import re
import unicodedata
from pathlib import Path

from studiorecon.errors import UserError

MAX_LETTERS = 100
# Letters and digits of any script with single blanks and marks between them; (1) is what a second download is called.
_NAME = re.compile(r"[\w(](?:[\w.+@()-]| (?! ))*(?<![ .])")
# What the rules' own language takes for its own.
_NOT_IN_PATHS = "{}\n\r"
_OF_THE_SYSTEM = {"thumbs.db", "desktop.ini", "__macosx", "lost+found", "system volume information", "ehthumbs.db"}


def checked_name(name: str, what: str, remedy: str) -> str:
    """``name``, if folders, tables and rules can bear it; raises UserError that says what it names and ``remedy``."""
    if len(name) > MAX_LETTERS or not _NAME.fullmatch(name):
        raise UserError(
            f"the name {name!r} of {what} cannot be used: letters, digits, single blanks and . _ - + @ ( ) may be in "
            f"it, a letter or digit first, {MAX_LETTERS} in all; {remedy}"
        )
    return name


def checked_place(path: Path) -> Path:
    """``path``, if the rules can bear it; raises UserError for braces and line ends in it."""
    if found := [letter for letter in _NOT_IN_PATHS if letter in str(path)]:
        raise UserError(f"the path {str(path)!r} holds {found[0]!r}, which the workflow cannot bear; rename the folder")
    return path


def folded(name: str) -> str:
    """``name`` as names are compared: composed letters (macOS stores decomposed ones), without case."""
    return unicodedata.normalize("NFC", name).casefold()


def of_the_system(path: Path) -> bool:
    """Whether a file or folder is one that operating systems and file servers leave beside the user's own."""
    return path.name.startswith((".", "._", "@ea", "$")) or path.name.casefold() in _OF_THE_SYSTEM


def segment_name(number: int) -> str:
    """How the views between two neighbouring cameras are called: by their gap's number, once around the scene."""
    return f"{number:02d}"
