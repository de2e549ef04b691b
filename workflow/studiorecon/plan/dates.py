# SPDX-License-Identifier: Apache-2.0
"""Files from the future: a recorder's clock that was wrong, or this machine's that has stepped back.

Snakemake goes by dates. A file made now is older than such an input, so that every job that reads it would fail at its
end, or run again at every start; it is better said before the first one.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path

from studiorecon.errors import UserError

# Clocks of file servers are off by less.
_TOLERATED_S = 5.0


def refuse_future(dataset: Path, results: Path, now_s: float) -> None:
    """Raises UserError when a file of ``dataset`` (its folder, and the folders in there), or of a scene's ``results``,
    is dated later than ``now_s``, in seconds since 1970: with the latest one, and the command that mends it."""
    today = time.strftime("%Y%m%d%H%M", time.localtime(now_s))
    for folder, paths in ((dataset, _near(dataset, 2)), (results, _near(results, 8))):
        dated = [(seconds, path) for path in paths if (seconds := path.lstat().st_mtime) > now_s + _TOLERATED_S]
        if dated:
            latest_s, latest = max(dated)
            date = time.strftime("%Y-%m-%d %H:%M", time.localtime(latest_s))
            raise UserError(
                f"{folder} holds files of the future ({len(dated)}, {latest} of {date}): the clock of the recorder or "
                "of this machine was wrong, and what is made now would count as older; set the clock right, or date "
                f"them today: find {folder} -newermt now -exec touch -t {today} {{}} +"
            )


def _near(folder: Path, levels: int) -> Iterator[Path]:
    """What lies in a folder, so many levels deep; links are not followed."""
    if levels == 0 or not folder.is_dir():
        return
    for path in folder.iterdir():
        yield path
        if not path.is_symlink():
            yield from _near(path, levels - 1)
