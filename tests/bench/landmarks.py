# SPDX-License-Identifier: Apache-2.0
"""Where the detector's landmarks lie on a body, and what its confidence is worth.

``python -m tests.bench.landmarks --folder DIR`` from the repository's root, DIR being what ``python -m
tests.bench.detector --parts single demo --folder DIR`` left there; writes ``tests/bench/results/landmarks.json``.
Per landmark: how far its triangulated point is from the true body's (the made studio's two people) and from that of a
body fitted to recorded OpenPose keypoints (a real man, after the one rigid motion between the two refined rigs), left
and right together, constant part and spread, millimetres. Then the bodies fitted with other worths of the confidence:
joints against the truth, and against the recorded keypoints' body.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import scipy
from studiorecon.body.model import BodyModel
from studiorecon.body.person_files import read_person
from studiorecon.camera_files.colmap import read_model
from studiorecon.keypoints.layouts import JOINT_NAMES, LAYOUTS
from studiorecon.people import fit
from studiorecon.people.fitting.points import lift, observations, off_m
from studiorecon.scene.camera import Camera
from studiorecon.scene.capture import read_manifest
from studiorecon.scene.people import Detections, Person, read_detections, read_identities

from tests.bench.detector import ROOT, rigid_mm
from tests.defaults import loaded

RESULT = Path(__file__).parent / "results" / "landmarks.json"
# In whose axes a landmark's offset is told: those of the joint that carries it.
CARRIER = {"ankle": "ankle", "big_toe": "ankle", "heel": "ankle", "ear": "head", "eye": "head", "nose": "head"}
CARRIER |= {"hip": "pelvis", "shoulder": "spine3", "knee": "knee", "elbow": "elbow", "wrist": "wrist"}
WORTH: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "as it stands": lambda c: c,
    "its root": np.sqrt,
    "its square": np.square,
    "share within 3 % of the height": lambda c: np.interp(c, [0, 0.2, 0.8, 1], [0.6, 0.7, 0.9, 1]),
    "all alike": np.ones_like,
}


@dataclass(frozen=True)
class Seen:
    """One person as the detector saw them: names (K), keypoints (V, T, K, 3), cameras, who is the ``truth``."""

    names: list[str]
    keypoints: np.ndarray
    cameras: list[Camera]
    detections: list[Detections]
    fps: float
    truth: Person
    exact: bool

    def joints_mm(self, settings: fit.Settings, worth: Callable[[np.ndarray], np.ndarray], body: BodyModel) -> float:
        """How far the fitted body's joints are from the truth's when confidences are worth that."""
        given = self.keypoints.copy()
        given[..., 2] = np.where(given[..., 2] > 0, np.clip(worth(given[..., 2]), 1e-3, 1), 0)
        points = lift(
            self.names,
            given,
            self.cameras,
            settings.triangulation,
            settings.fit.unverified_sigma_m,
            off_m(self.names, self.detections),
        )
        fitted = fit.fit_person(self.truth.name, points, body, self.fps, settings)[0]
        if self.exact:
            return float(1000 * np.linalg.norm(fitted.joints - self.truth.joints, axis=-1).mean())
        both = fitted.valid & self.truth.valid
        return rigid_mm(fitted.joints[both], self.truth.joints[both])


def seen(scene: Path, person: str, truth: Person, exact: bool, body: BodyModel) -> Seen:
    """One person of a finished scene."""
    cameras, footage = read_model(scene / "cameras"), read_manifest(scene / "capture/manifest.json")
    detections = [read_detections(scene / f"people/detections/{c.name}.npz") for c in cameras]
    who = read_identities(scene / "people/identities.tsv")
    names, keypoints = observations(person, detections, who, body, footage.frames)
    return Seen(list(names), keypoints, cameras, detections, footage.fps, truth, exact)


def offsets_mm(one: Seen, settings: fit.Settings, body: BodyModel) -> dict[str, np.ndarray]:
    """Landmark without its side → (N, 3) offsets from the true body's, in the carrying joint's axes, left mirrored
    onto right."""
    about, truth = (settings.triangulation, settings.fit.unverified_sigma_m), one.truth
    points = lift(one.names, one.keypoints, one.cameras, *about).points_m
    own = body.keypoints(tuple(one.names), truth.poses, truth.betas, truth.trans)
    if not one.exact:
        known = np.isfinite(points).all(-1)
        a, b = points[known], own[known]
        rotation, _ = scipy.spatial.transform.Rotation.align_vectors(b - b.mean(0), a - a.mean(0))
        points = rotation.apply(points.reshape(-1, 3) - a.mean(0)).reshape(points.shape) + b.mean(0)
    world = body.joint_transforms(truth.poses, truth.betas, truth.trans)[..., :3, :3]
    found: dict[str, list[np.ndarray]] = {}
    for k, name in enumerate(one.names):
        side, _, part = name.partition("_") if "_" in name else ("", "", name)
        joint = CARRIER.get(part)
        if joint is None:
            continue
        carrier = JOINT_NAMES.index(f"{side}_{joint}" if f"{side}_{joint}" in JOINT_NAMES else joint)
        local = np.einsum("tji,tj->ti", world[:, carrier], points[:, k] - own[:, k])
        found.setdefault(part, []).append(1000 * local * ([-1, 1, 1] if side == "right" else [1, 1, 1]))
    return {part: np.concatenate(parts) for part, parts in found.items()}


def main() -> None:
    """A line per landmark, and per worth of the confidence."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--folder", type=Path, required=True)
    results = parser.parse_args().folder / "results"
    settings, body = loaded(fit.Settings), BodyModel.load(ROOT / "resources/body.npz")
    people = {
        f"demo {p}": seen(
            results / "demo", p, read_person(results / f"studio/demo/truth/bodies/{p}.npz"), exact=True, body=body
        )
        for p in ("p0", "p1")
    }
    recorded = read_person(results / "recorded/people/p0.npz")
    people["real man"] = seen(results / "found", "p0", recorded, exact=False, body=body)
    table: dict[str, Any] = {"landmarks": {}, "confidence": {}}
    offsets = {name: offsets_mm(one, settings, body) for name, one in people.items()}
    layout = LAYOUTS["blazepose33"]
    for part in CARRIER:
        row = {}
        for name, found in offsets.items():
            known = found[part][np.isfinite(found[part]).all(1)]
            constant = np.median(known, axis=0)
            spread = np.median(np.linalg.norm(known - constant, axis=1))
            row[name] = {"constant_mm": constant.round().astype(int).tolist(), "spread_mm": round(float(spread))}
        table["landmarks"][part] = row
        told = ", ".join(f"{n}: {r['constant_mm']} ± {r['spread_mm']}" for n, r in row.items())
        print(f"{part:9s} {told} mm (taken as {1000 * layout.off_m(part):.0f})")
    for name, worth in WORTH.items():
        row = {who: round(one.joints_mm(settings, worth, body), 1) for who, one in people.items()}
        table["confidence"][name] = row
        print(f"confidence {name}: " + ", ".join(f"{who} {mm} mm" for who, mm in row.items()), flush=True)
    RESULT.write_text(json.dumps(table, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
