# SPDX-License-Identifier: Apache-2.0
"""Refuses files dated in the future, from a recorder with a wrong clock or after this machine's clock was set back.

Snakemake compares dates. An output made now would be older than such an input, so its job would fail at the end or run
again at every start. An error before the first job costs nothing.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path

from studiorecon.errors import UserError


def refuse_future(dataset: Path, results: Path, now_s: float) -> None:
    """Raises UserError for a file dated later than ``now_s`` (since 1970); names the latest and the remedy's command.

    Checks ``dataset`` (its folder and subfolders) and a scene's ``results``.
    """
    today = time.strftime("%Y%m%d%H%M", time.localtime(now_s))
    for folder, paths in ((dataset, _near(dataset, 2)), (results, _near(results, 8))):
        # Clocks of file servers differ by less.
        dated = [(seconds, path) for path in paths if (seconds := path.lstat().st_mtime) > now_s + 5.0]
        if dated:
            latest_s, latest = max(dated)
            date = time.strftime("%Y-%m-%d %H:%M", time.localtime(latest_s))
            raise UserError(
                f"{folder} holds files dated in the future ({len(dated)}, the latest {latest}: {date}): the clock of "
                "the recorder or of this machine was wrong, and new results would seem older; correct the clock, or "
                f"date the files today: find {folder} -newermt now -exec touch -t {today} {{}} +"
            )


def _near(folder: Path, levels: int) -> Iterator[Path]:
    """Files and folders up to ``levels`` deep in a folder, without following links."""
    if levels == 0 or not folder.is_dir():
        return
    for path in folder.iterdir():
        yield path
        if not path.is_symlink():
            yield from _near(path, levels - 1)
