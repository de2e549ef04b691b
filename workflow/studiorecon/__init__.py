# SPDX-License-Identifier: Apache-2.0
"""studiorecon: from the videos of a few static, far-apart cameras to a 4D scene.

How to read it
--------------
The ``Snakefile`` lists the stages in the order of the data. ``workflow/rules/<stage>.smk`` declares inputs and outputs
of each step; ``studiorecon/<stage>/<step>.py`` is the step. Only its ``run()`` reads and writes files, everything below
is functions on arrays. The first page of a folder (``__init__.py``) names inputs, outputs and the order of reading.

``stages`` lists the stages; they never import each other, and no rule takes an input of a later one. Three tools use
them: ``studio`` films synthetic captures with known truth, ``placement`` plans camera positions, ``sweep`` measures
what accuracy costs.

Foundations (import no stage, and only foundations before them): ``pages`` (HTML), ``scene`` (data types and their
files), ``geometry``, ``camera_files``, ``footage``, ``images``, ``keypoints``, ``detector``, ``body``, ``rig``,
``splatting``. ``models`` holds the adapters of upstream networks, ``recursive`` the paper's recursive module.
``results`` reads a finished scene: ``studiorecon.load(FOLDER)``; ``studiorecon.draw`` renders it.

Glossary
--------
frame              one moment of the capture, numbered from 0, the same in all cameras
image, photo       an array of pixels; a photo comes from a camera, a *render* is drawn
footage            a camera's recording in the user's form: a video file or a folder of images
video, film        a video is frames in a file of this project; a film is a video made to be watched
shot               one entry of ``render.shots``: camera path, lens and times of one film
view               the scene from one camera; a *synthesised view* is drawn from a pose between two cameras
training camera    a camera whose footage every fit may use
held-out camera    a camera that only the report uses, and the check of its own pose
validation split   data that a fit does not use and its result is scored on
keypoint           a named point of the body in an image, with a confidence; in the world it is a *joint*
detection          the keypoints of one person in one frame of one camera
track              detections of one person in one camera over time
identity           the person of a track; persons are ``p0``, ``p1``, ...
present, away      whether a person or object is in the scene in a frame; while away they are not drawn
time offset        seconds from the reference camera's first frame to this camera's; *drift* changes it, in ppm
readout            time in which a rolling shutter reads one picture, from the first row to the last
calibration        intrinsics (focal length, principal point, distortion) and extrinsics (pose) of the cameras
pose               rotation and translation: of a camera ``camera_from_world``, of a body one rotation per joint
rig                all cameras of a capture with their poses
reprojection error distance in pixels between a keypoint and its projected joint
residual           difference between a measurement and the model's prediction
inlier, outlier    a measurement whose residual is within, or beyond, the range of its noise
prior              an assumption before the data: a bone length, the given calibration with its sigma
sigma              standard deviation; *interval* means 95 % unless stated otherwise
undetermined       a result: the data do not decide, and the reason says why
proposal           a candidate (box, wall, pose) that the images then accept or reject
plate              the background image of a camera: the room without people, with a mask of known pixels
room box           floor, ceiling and four walls; *primitives* are upright boxes inside it
object             a rigid thing that moves and is not a person
effect             something a scene may call for (shadows, exposure); the *survey* measures and decides it
gain               factor on the brightness of a camera or a frame
mask, matte        the pixels of one person; a matte has soft edges
body               parametric body model: shape, pose, translation; *rest pose* is the one it is modelled in
skinning weights   share of each bone in the motion of a point
Gaussian           an anisotropic 3D Gaussian with opacity and colour, drawn by splatting
human              Gaussians on one person's body in its rest pose, with skinning weights
provenance         measured (cameras agree), inferred (fitted or continued), invented (painted where no camera saw)
enhancement        adding detail that renders miss at the photos; *injection* makes it consistent in time

Conventions
-----------
``b_from_a`` maps coordinates of a to those of b. Names carry units (``_m, _px, _rad, _deg, _s``). World: right-handed,
metres, z up. Cameras as in OpenCV: x right, y down, z forward; the first pixel's centre is (0.5, 0.5). Quaternions are
(w, x, y, z). Ids like T13 are hard cases of the arithmetic (``tests/hard/rows.tsv``), U07 readings of ambiguous
passages of the paper (``docs/readings.md``). ``UserError`` is one sentence for the user: problem, place and remedy.
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
    from studiorecon.geometry.triangulation import TriangulatedPoints
    from studiorecon.people.association.grouping import Group
    from studiorecon.rig.calibrated import CalibratedEstimate
    from studiorecon.scene.camera import Camera
    from studiorecon.scene.people import Detections
    from studiorecon.splatting.rendering import Rendering


def load(folder: str | Path, body: str | Path | None = None) -> FinishedScene:
    """The finished scene of ``results/<scene>`` as numpy arrays.

    ``body`` is the body model of the fit if it is not the bundled one. Raises ``errors.UserError`` if there is no such
    scene or one of its files is broken.
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
    """The view of ``camera`` at a frame: (H, W, 3) ``rgb``, (H, W) ``alpha`` and ``depth_m``; see ``results.draw``."""
    from studiorecon import results

    return results.draw(scene, camera, frame, without, background_rgb)


def triangulate(
    pixels: Num[np.ndarray, "V ... 2"], confidence: Num[np.ndarray, "V ..."], cameras: Sequence[Camera]
) -> TriangulatedPoints:
    """World points in metres from ``pixels`` (V, ..., 2) of V cameras with ``confidence`` (V, ...); NaN is unseen.

    Uses the default limits of the workflow; ``geometry.triangulation.triangulate`` takes others. Raises ValueError for
    shapes that do not agree.

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
    """One Group per person: the tracks of all cameras, and the triangulated keypoints, (T, K, 3) metres.

    Uses the default limits of ``people.associate``; ``people.association`` takes others, and decides which groups are
    persons.

    >>> people = studiorecon.associate(detections, cameras, fps=30)
    >>> [len(person.members) for person in people]
    [4, 4]
    >>> people[0].points_m.shape
    (30, 12, 3)
    """
    from studiorecon.geometry.triangulation import Limits
    from studiorecon.people.association.affinity import AssociationLimits
    from studiorecon.people.association.gaps import group_tracks
    from studiorecon.people.association.grouping import TrackComparison

    frames = max((int(found.frame.max()) + 1 for found in detections if len(found.frame)), default=0)
    return group_tracks(TrackComparison(detections, cameras, frames, fps, AssociationLimits(), Limits()))[0]


def refine(cameras: Sequence[Camera], detections: Sequence[Detections]) -> CalibratedEstimate | None:
    """Cameras by people's keypoints, with the given cameras as prior: as given, refined, or moved.

    None if the keypoints do not determine them. The step ``cameras.refine`` also refuses calibrations of other cameras.

    >>> nearer = studiorecon.refine(moved, detections)
    >>> before, after = (np.linalg.norm(c[1].centre_m - cameras[1].centre_m) for c in (moved, nearer.cameras))
    >>> bool(after < before / 2)
    True
    """
    import numpy as np

    from studiorecon.geometry.camera_motion import PoseError
    from studiorecon.geometry.triangulation import Limits
    from studiorecon.people.association.affinity import AssociationLimits
    from studiorecon.rig.calibrated import estimate_calibrated

    frames = np.unique(np.concatenate([found.frame for found in detections]))
    return estimate_calibrated(
        cameras, detections, frames, AssociationLimits().gate_m, Limits(), PoseError(), lost=True
    )


def score(
    renders: str | Path, truth: str | Path, masks: str | Path | None = None, lpips: str | Path | None = None
) -> dict[str, Any]:
    """Every measure of one folder of films against another, as ``report.score`` writes it: PSNR, SSIM, over time, …

    Raises ``errors.UserError`` if the folders share no camera, or films differ in size or length.

    >>> found = studiorecon.score(folder / "renders", folder / "photos")["pictures"]["renders"]
    >>> found["psnr"]["value"] > 30, found["lpips"]["value"] is None
    (True, True)
    """
    from pathlib import Path

    from studiorecon.report import score as films

    return films.score(Path(renders), Path(truth), Path(masks) if masks else None, Path(lpips) if lpips else None)
