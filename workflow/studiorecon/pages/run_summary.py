# SPDX-License-Identifier: Apache-2.0
"""The last lines of a run: every warning once, then the paths of the results."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path

from studiorecon.progress import WARNING

# Results that a user opens: name, possible files below results/<scene>, and the rule that makes them.
_RESULTS = (
    ("film", "enhance/*.mp4", "enhance_shot"),
    ("page", "report/index.html", "report_page"),
    ("player", "deliver/player.html", "deliver_player"),
    ("doctor", "calibration/doctor.html", "calibration_doctor"),
    ("plan", "placement/advice.svg", "placement_advise"),
)
_OF_A_WHOLE_RUN = 3


def read_warnings(logs: Path) -> list[tuple[str, str]]:
    """(step, sentence) of every warning in the logs of a scene's latest jobs; each sentence once, by file name.

    Warnings of a preview (``people/first``) do not count once the step itself has run.
    """
    found: dict[tuple[str, str], None] = {}
    for log in sorted(logs.rglob("*.log")):
        if log.parent.name == "first" and (log.parents[1] / log.name).is_file():
            continue
        step = ".".join(log.relative_to(logs).with_suffix("").parts)
        for line in log.read_text(encoding="utf-8", errors="replace").splitlines():
            if line.startswith(WARNING):
                found[step, line.removeprefix(WARNING)] = None
    return list(found)


def list_results(folder: Path, rules: Collection[str] | None) -> list[tuple[str, Path]]:
    """(name, file) of the results in ``results/<scene>`` that a run of these ``rules`` made.

    None means a run that had nothing to do: all results count. A run that made the page made all of them.
    """
    whole = rules is None or "report_page" in rules
    found = []
    for k, (what, pattern, rule) in enumerate(_RESULTS):
        files = sorted(path for path in folder.glob(pattern) if "." not in path.stem)
        # The film of the held-out cameras is only for measurement.
        files = [path for path in files if path.stem != "heldout"] or files
        if files and ((k < _OF_A_WHOLE_RUN) if whole else rule in (rules or ())):
            found.append((what, files[0]))
    return found


def closing_lines(
    scene: str, rules: Collection[str] | None, results: Path = Path("results"), logs: Path = Path("logs")
) -> str:
    """The last lines of a run of ``rules``; without the warnings for a run that had nothing to do (None)."""
    warned: dict[str, list[str]] = {}
    for step, sentence in read_warnings(logs / scene) if rules is not None else ():
        warned.setdefault(sentence, []).append(step)
    lines = [f"{len(warned)} warning{'s' if len(warned) > 1 else ''}:"] if warned else []
    for sentence, steps in warned.items():
        more = f" and {len(steps) - 1} more" if len(steps) > 1 else ""
        lines.append(f"  {sentence} ({steps[0]}{more})")
    return "\n".join([*lines, *(f"{what + ':':<8}{path}" for what, path in list_results(results / scene, rules))])
