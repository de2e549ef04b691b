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
truth, ``placement`` says where to put cameras, ``sweep`` measures what accuracy costs.

Foundations (never import a stage, and of one another only those before): ``pages`` (for people to read), ``scene``
(nouns and their files), ``geometry``, ``camera_files``, ``footage``, ``images``, ``keypoints``, ``detector``, ``body``,
``rig``, ``splatting``; ``models`` holds the upstream networks' adapters, ``recursive`` the paper's recursive module,
which works with any of them. ``results`` reads a finished scene:
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
away             a person or thing is not there in a frame, and not drawn; else it is *present*
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
    from typing import Any

    import numpy as np
    from jaxtyping import Num

    from studiorecon.deliver.finished import FinishedScene
    from studiorecon.geometry.bundle import Adjusted
    from studiorecon.geometry.triangulation import Triangulated
    from studiorecon.people.association.grouping import Group
    from studiorecon.scene.camera import Camera
    from studiorecon.scene.people import Detections
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


def triangulate(
    pixels: Num[np.ndarray, "V ... 2"], confidence: Num[np.ndarray, "V ..."], cameras: Sequence[Camera]
) -> Triangulated:
    """World points, metres, of ``pixels`` (V, ..., 2) that V cameras saw with ``confidence`` (V, ...); NaN is unseen.

    With the limits that steps begin with; ``geometry.triangulation.triangulate`` takes others. Raises ValueError for
    shapes that do not fit together.

    >>> point = [[0.2, -0.1, 1.5]]
    >>> pixels = np.stack([camera.project(point)[0] for camera in cameras])
    >>> found = studiorecon.triangulate(pixels, np.ones(pixels.shape[:-1]), cameras)
    >>> found.points_m.round(6).tolist(), found.verified.tolist()
    ([[0.2, -0.1, 1.5]], [True])
    """
    from studiorecon.geometry.triangulation import Limits
    from studiorecon.geometry.triangulation import triangulate as meeting

    return meeting(pixels, confidence, cameras, Limits())


def associate(detections: Sequence[Detections], cameras: Sequence[Camera], fps: float) -> list[Group]:
    """Tracks of all cameras that show one person, and where its keypoints are: (T, K, 3) metres; one Group each.

    With the limits that ``people.associate`` begins with; ``people.association`` takes others, and says who counts as a
    person.

    >>> people = studiorecon.associate(detections, cameras, fps=30)
    >>> [len(person.members) for person in people]
    [4, 4]
    >>> people[0].points_m.shape
    (30, 12, 3)
    """
    from studiorecon.geometry.triangulation import Limits
    from studiorecon.people.association.affinity import AssociationLimits
    from studiorecon.people.association.grouping import group_tracks

    frames = max((int(found.frame.max()) + 1 for found in detections if len(found.frame)), default=0)
    return group_tracks(detections, cameras, frames, fps, AssociationLimits(), Limits())


def refine(cameras: Sequence[Camera], detections: Sequence[Detections]) -> Adjusted | None:
    """Cameras moved to where the people in the pictures call for, as a bundle adjustment that trusts the given ones.

    None where people show too little. ``cameras.refine`` decides besides whether that helps.

    >>> nearer = studiorecon.refine(moved, detections)
    >>> before, after = (np.linalg.norm(c[1].centre_m - cameras[1].centre_m) for c in (moved, nearer.cameras))
    >>> bool(after < before / 2)
    True
    """
    import numpy as np

    from studiorecon.geometry.bundle import BundleSettings
    from studiorecon.geometry.triangulation import Limits
    from studiorecon.people.association.affinity import AssociationLimits
    from studiorecon.rig.bundle import fitted
    from studiorecon.rig.correspondences import observe

    frames = np.unique(np.concatenate([found.frame for found in detections]))
    seen, _ = observe(detections, cameras, frames, AssociationLimits().gate_m)
    return fitted(cameras, seen, Limits(), BundleSettings())


def score(
    renders: str | Path, truth: str | Path, masks: str | Path | None = None, lpips: str | Path | None = None
) -> dict[str, Any]:
    """Every measure of one folder of films against another, as ``report.score`` writes it: PSNR, SSIM, in time, …

    Raises ``errors.UserError`` when the folders have no camera in common, or films of other sizes and lengths.

    >>> found = studiorecon.score(folder / "renders", folder / "photos")["pictures"]["renders"]
    >>> found["psnr"]["value"] > 30, found["lpips"]["value"] is None
    (True, True)
    """
    from pathlib import Path

    from studiorecon.report import score as films

    return films.score(Path(renders), Path(truth), Path(masks) if masks else None, Path(lpips) if lpips else None)
