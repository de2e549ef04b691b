# SPDX-License-Identifier: Apache-2.0
"""Progress of a training loop: a message and a picture at every tenth of the way, and the latest picture meanwhile."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, SupportsFloat

import numpy as np

from studiorecon.images.encoded import jpeg, write_png
from studiorecon.images.metrics import psnr
from studiorecon.progress import LATEST, LOGGER, say
from studiorecon.scene.files import atomic_path

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Num


# A picture of a room costs about a tenth of a second; one every fifty times as long takes 2 % of the time.
_SHARE = 50.0
# A person who watches sees no change sooner.
_MIN_EVERY_S = 3.0


class Feedback:
    """Losses and PSNRs of every iteration so far, restored in a resumed run, and their reports."""

    def __init__(self, label: str, first: int, last: int, previews: Path | None) -> None:
        self.losses: list[SupportsFloat] = []
        self.psnrs_db: list[SupportsFloat] = []
        self._label, self._first, self._last, self._previews = label, first, last, previews
        self._tenth = max(1, (last - first) // 10)
        self._next_s = time.monotonic() + _MIN_EVERY_S

    def record(self) -> dict[str, Float[np.ndarray, " I"]]:
        """The values added so far, for a checkpoint."""
        return {"losses": _numbers(self.losses), "psnrs_db": _numbers(self.psnrs_db)}

    def resume(self, record: Mapping[str, Float[np.ndarray, " I"]]) -> None:
        """Restore the ``record`` of an interrupted run."""
        self.losses, self.psnrs_db = record["losses"].tolist(), record["psnrs_db"].tolist()

    def add(self, loss: SupportsFloat, psnr_db: SupportsFloat) -> bool:
        """Record one iteration; returns True when a tenth is done and ``report_progress`` is due.

        Numbers on a device are read when they are reported, so that no step waits for them.
        """
        self.losses.append(loss)
        self.psnrs_db.append(psnr_db)
        return len(self.losses) % self._tenth == 0

    def show_latest(self, draw: Callable[[], Num[np.ndarray, "H W 3"]]) -> None:
        """Write what ``draw`` returns as the latest picture, where one is due."""
        begun_s = time.monotonic()
        if self._previews is None or begun_s < self._next_s:
            return
        from studiorecon.footage.video import to_bytes

        with contextlib.suppress(OSError), atomic_path(self._previews / LATEST) as partial:
            partial.write_bytes(jpeg(to_bytes(np.nan_to_num(draw())), 85))
        ended_s = time.monotonic()
        self._next_s = ended_s + max(_MIN_EVERY_S, _SHARE * (ended_s - begun_s))

    def end(self) -> None:
        """Remove the latest picture."""
        if self._previews is not None:
            (self._previews / LATEST).unlink(missing_ok=True)

    @property
    def last_psnr_db(self) -> float:
        """Mean PSNR over the last tenth, on the pixels that counted; 0 before the first iteration."""
        return float(_numbers(self.psnrs_db[-self._tenth :]).mean()) if self.psnrs_db else 0.0

    def report_progress(
        self,
        count: int,
        view: str,
        shown: Num[np.ndarray, "H W 3"],
        wanted: Num[np.ndarray, "H W 3"],
        used: Bool[np.ndarray, "H W"],
    ) -> None:
        """Log one line of progress and write ``preview_<percent>.png``: left ``wanted``, right ``shown``.

        PSNR is over the pixels ``used`` of the training ``view``, so it does not measure unseen views.
        """
        done, loss = len(self.losses), _numbers(self.losses[-self._tenth :]).mean()
        score = psnr(shown, wanted, used)
        on_view = "too few pixels to score" if score is None else f"{score:.2f} dB"
        described = (
            f"{self._label}: {self._first + done} of {self._last}, loss {loss:.4f}, "
            f"PSNR {self.last_psnr_db:.2f} dB on the last picture, {on_view} on training view {view}, {count} "
            "Gaussians"
        )
        # Every tenth is logged; only the last is shown.
        (say if self._first + done == self._last else LOGGER.debug)(described)
        if self._previews is not None:
            percent = round(100 * done / (self._last - self._first))
            # Loaded here: it imports the decoders of films, which takes longer than a small training needs to start.
            from studiorecon.footage.video import to_bytes

            sheet = np.concatenate([to_bytes(np.nan_to_num(wanted)), to_bytes(np.nan_to_num(shown))], axis=1)
            write_png(self._previews / f"preview_{percent:03d}.png", sheet)


def _numbers(values: Sequence[SupportsFloat]) -> Float[np.ndarray, " I"]:
    return np.array([float(value) for value in values])
