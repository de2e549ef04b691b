# SPDX-License-Identifier: Apache-2.0
"""Readers of calibration formats: one file per format, each ending with its ``FORMAT``, all listed here.

A reader takes the paths of a user's files and returns a ``reading.Reading``: cameras in the file's own world and unit.
``plan.discovery`` finds files by this list, ``calibration.files`` reads them by it, and the setting
``calibration.format``, the sentences of refusals and the table of docs/capture.md are made from it. Begin with
``reading``; ``easymocap`` is a plain example. ``docs/contributing.md`` says how to add one.
"""

from __future__ import annotations

from studiorecon.calibration.formats.alicevision import FORMAT as ALICEVISION
from studiorecon.calibration.formats.biocv import FORMAT as BIOCV
from studiorecon.calibration.formats.board import FORMAT as BOARD
from studiorecon.calibration.formats.colmap_files import FORMAT as COLMAP
from studiorecon.calibration.formats.easymocap import FORMAT as EASYMOCAP
from studiorecon.calibration.formats.egoexo import FORMAT as EGOEXO
from studiorecon.calibration.formats.egohumans import FORMAT as EGOHUMANS
from studiorecon.calibration.formats.llff import FORMAT as LLFF
from studiorecon.calibration.formats.nerfstudio import FORMAT as NERFSTUDIO
from studiorecon.calibration.formats.opencap import FORMAT as OPENCAP
from studiorecon.calibration.formats.opencv_storage import FORMAT as OPENCV
from studiorecon.calibration.formats.optitrack import FORMAT as OPTITRACK
from studiorecon.calibration.formats.pose2sim import CALISCOPE
from studiorecon.calibration.formats.pose2sim import FORMAT as POSE2SIM
from studiorecon.calibration.formats.qualisys import FORMAT as QUALISYS
from studiorecon.calibration.formats.reading import CalibrationFormat
from studiorecon.calibration.formats.train_meta import FORMAT as TRAIN_META
from studiorecon.calibration.formats.vicon import FORMAT as VICON
from studiorecon.calibration.formats.zju import FORMAT as ZJU

# In the order in which files are searched and recognised: the first format that matches counts.
_LISTED = (
    EASYMOCAP,
    COLMAP,
    EGOHUMANS,
    NERFSTUDIO,
    TRAIN_META,
    EGOEXO,
    LLFF,
    ZJU,
    CALISCOPE,
    POSE2SIM,
    QUALISYS,
    ALICEVISION,
    VICON,
    OPTITRACK,
    OPENCAP,
    BIOCV,
    OPENCV,
    BOARD,
)
FORMATS: dict[str, CalibrationFormat] = {form.name: form for form in _LISTED}


def accepted_formats() -> str:
    """All accepted files, as one phrase for a sentence."""
    return ", ".join(f"{form.files_in_words.replace('`', '')} ({form.made_by})" for form in FORMATS.values())


def formats_table() -> str:
    """The formats as a table in Markdown."""
    rows = [f"| {form.files_in_words} | {form.made_by} | `{form.name}` |" for form in FORMATS.values()]
    return "\n".join(["| files in the dataset's folder | written by | `calibration.format` |", "|---|---|---|", *rows])
