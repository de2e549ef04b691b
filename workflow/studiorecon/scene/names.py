# SPDX-License-Identifier: Apache-2.0
"""Checks names of cameras and scenes, which become folders, wildcards and columns."""

from __future__ import annotations

import os
import re
import unicodedata
from collections.abc import Sequence
from pathlib import Path

from studiorecon.errors import UserError

MAX_LETTERS = 100
# Letters and digits of any script with single blanks and marks between them; browsers name a second download with (1).
_NAME = re.compile(r"[\w(](?:[\w.+@()-]| (?! ))*(?<![ .])")
# Snakemake takes a name that ends in twenty equal parts for a rule that feeds itself, and stops.
_REPEATED = re.compile(r"(.+)\1{19}$")
# Characters with a meaning in Snakemake's rules.
_NOT_IN_PATHS = "{}\n\r"
_OF_THE_SYSTEM = {"thumbs.db", "desktop.ini", "__macosx", "lost+found", "system volume information", "ehthumbs.db"}


def check_name(name: str, what: str, remedy: str) -> str:
    """``name``, if folders, tables and rules can use it; else raises UserError with ``what`` it names and
    ``remedy``."""
    if len(name) > MAX_LETTERS or not _NAME.fullmatch(name):
        raise UserError(
            f"the name {name!r} of {what} cannot be used: letters, digits, single spaces and . _ - + @ ( ) are "
            f"allowed, starting with a letter or digit, {MAX_LETTERS} characters at most; {remedy}"
        )
    if found := _REPEATED.search(name):
        raise UserError(
            f"the name {name!r} of {what} cannot be used: it repeats {found[1]!r} twenty times or more; {remedy}"
        )
    return name


def as_paths(arguments: Sequence[str]) -> list[str]:
    """Arguments of a program in which a file or folder called ``-rf`` is called ``./-rf``, which is no option."""
    return [f"./{word}" if word[:1] == "-" != word and os.path.exists(word) else word for word in arguments]


def check_path(path: Path) -> Path:
    """``path``, if the rules can use it; raises UserError for braces and line ends in it."""
    if found := [letter for letter in _NOT_IN_PATHS if letter in str(path)]:
        raise UserError(
            f"the path {str(path)!r} holds {found[0]!r}, which the workflow cannot handle; rename the folder"
        )
    return path


def compose_unicode(name: str) -> str:
    """``name`` with composed letters: macOS stores u and a mark for ü."""
    return unicodedata.normalize("NFC", name)


def fold_name(name: str) -> str:
    """``name`` in the form for comparison: composed letters, without case."""
    return compose_unicode(name).casefold()


def is_system_file(path: Path) -> bool:
    """Whether a file or folder is one that operating systems and file servers add to a user's folder."""
    return path.name.startswith((".", "._", "@ea", "$")) or path.name.casefold() in _OF_THE_SYSTEM


def segment_name(number: int) -> str:
    """The name of the views between two neighbouring cameras: their gap's number, once around the scene."""
    return f"{number:02d}"
