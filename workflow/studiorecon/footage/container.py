# SPDX-License-Identifier: Apache-2.0
"""A film's container, opened for reading, whichever PyAV is installed and whatever bytes its tags are of."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import av

# Until PyAV 19 a tag that is not UTF-8 fails the opening unless it is told what to do instead; from there on such bytes
# come as lone surrogates, and the argument is gone.
_TAGS: dict[str, Any] = {} if int(av.__version__.partition(".")[0]) >= 19 else {"metadata_errors": "replace"}


def opened(path: Path | str) -> av.container.InputContainer:
    """The container at ``path``, to be used in a ``with``; raises av.FFmpegError when it is none."""
    return av.open(str(path), "r", **_TAGS)
