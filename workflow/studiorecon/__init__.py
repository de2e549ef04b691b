# SPDX-License-Identifier: Apache-2.0
"""studiorecon: from the videos of a few static, far-apart cameras to a 4D scene.

How to read it
--------------
The ``Snakefile`` lists the stages in the order in which data meets them; ``workflow/rules/<stage>.smk`` says what each
step takes and makes; ``studiorecon/<stage>/<step>.py`` is the step. Its ``run()`` alone touches files, everything below
it is functions on arrays. The first page of a folder (``__init__.py``) says what comes in, what goes out, and in which
order to read.

Stages (never import each other; no rule takes an input of a later one):
``detect, clocks, calibration, capture, tracks, plates, cameras, people, depth, survey, objects, masks, views,
background, humans, render, enhance, deliver, report``. Beside them ``studio`` films synthetic captures with their
truth, ``planner`` says where to put cameras, ``sweep`` measures what accuracy costs.

Foundations (never import a stage, and of one another only those before): ``pages`` (for people to read), ``scene``
(nouns and their files), ``geometry``, ``camera_files``, ``footage``, ``images``, ``keypoints``, ``detector``, ``body``,
``rig``, ``splatting``; ``models`` holds the upstream networks' adapters. ``results`` reads a finished scene:
``studiorecon.load(FOLDER)``, and ``studiorecon.draw`` makes a picture of it.

Words
-----
frame            one moment of the capture, numbered from 0 in all cameras alike
image            an array of pixels; a *photo* is one that a camera took, a *render* one that was drawn
footage          what a camera recorded, as the user has it: a video file or a folder of images
video            frames as a file of this project; a *film* is a video that somebody will watch
shot             one film to be made, as ``render.shots`` describes it: a camera path, a lens, and the time
detection        one person's keypoints in one frame of one camera; a *track* follows one person in one camera
identity         which person a track belongs to; persons are ``p0``, ``p1``, …
plate            the background image of a camera: the room without people, and where it was measured
room box         floor, ceiling and four walls; *primitives* are the upright boxes and cylinders in it
object           something rigid that moves and is no person
provenance       measured (cameras agree on it), inferred (fitted or continued), invented (painted where nobody saw)
gain             factor on a camera's or a frame's brightness
validation split what a fit does not see and is judged on
held-out camera  filmed, but only the report may look at it, and what checks where it stands
undetermined     an answer: the evidence does not decide, and the reason says why

Conventions
-----------
``b_from_a`` maps coordinates of a to those of b. Units stand in names (``_m, _px, _rad, _deg, _s``). World: right-
handed, metres, z up. Cameras as in OpenCV: x right, y down, z forward; the first pixel's centre is (0.5, 0.5).
Quaternions are (w, x, y, z). Ids like T13 are hard cases of the arithmetic (``docs/hard-cases.md``), U07 readings
of ambiguous passages of the paper (``docs/readings.md``). ``UserError`` is one sentence for the person who runs the
workflow: what, where, and what would help.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Collection, Sequence
    from pathlib import Path

    from studiorecon.deliver.finished import FinishedScene
    from studiorecon.scene.camera import Camera
    from studiorecon.splatting.rendering import Rendering


def load(folder: str | Path, body: str | Path | None = None) -> FinishedScene:
    """The finished scene of ``results/<scene>`` as numpy arrays.

    ``body`` is the body model that people were fitted with, where that is not the bundled one. Raises
    ``errors.UserError``, one sentence, when there is no such scene or a file of it is broken.
    """
    from studiorecon import results  # not at once: every step imports this page

    return results.load(folder, body)


def draw(
    scene: FinishedScene,
    camera: Camera,
    frame: float,
    without: Collection[str] = (),
    background_rgb: Sequence[float] = (0.0, 0.0, 0.0),
) -> Rendering:
    """The scene as ``camera`` sees it at a frame: (H, W, 3) ``rgb``, (H, W) ``alpha`` and ``depth_m``; see
    ``results.draw``."""
    from studiorecon import results

    return results.draw(scene, camera, frame, without, background_rgb)
