# SPDX-License-Identifier: Apache-2.0
"""Made sets of Gaussians for the splatting tests and benchmarks: an ordinary room, and one that is meant to break a
rasteriser."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from studiorecon.scene.camera import Camera
from studiorecon.scene.gaussians import Gaussians, sh_from_rgb
from studiorecon.splatting.cpu.rasterise import Rasteriser
from studiorecon.splatting.rendering import Drawable, Rendering


def rasterise(
    gaussians: Drawable, view: Camera, *, near_m: float, threads: int | None = None, **more: object
) -> Rendering:
    """One view on the CPU; ``more`` as for ``Rasteriser.forward``."""
    return Rasteriser(near_m=near_m, threads=threads).forward(gaussians, view, **more)


def with_colours(gaussians: Gaussians, rgb: np.ndarray) -> Gaussians:
    """The same shapes with constant colours (N, 3)."""
    return replace(gaussians, sh=sh_from_rgb(rgb)[:, None, :])


def camera(width: int, height: int, principal_shift_px: tuple[float, float] = (0.0, 0.0)) -> Camera:
    """60° wide, turned a little about two axes, near the origin and looking along +z."""
    focal = 0.5 * width / np.tan(np.radians(30))
    yaw, pitch = 0.1, 0.05
    about_y = np.array([[np.cos(yaw), 0, np.sin(yaw)], [0, 1, 0], [-np.sin(yaw), 0, np.cos(yaw)]])
    about_x = np.array([[1, 0, 0], [0, np.cos(pitch), -np.sin(pitch)], [0, np.sin(pitch), np.cos(pitch)]])
    camera_from_world = np.eye(4)
    camera_from_world[:3, :3] = about_x @ about_y
    camera_from_world[:3, 3] = [0.05, -0.1, 0.2]
    principal = (width / 2 + principal_shift_px[0], height / 2 + principal_shift_px[1])
    intrinsics = np.array([[focal, 0, principal[0]], [0, focal, principal[1]], [0, 0, 1.0]])
    return Camera("test", (width, height), intrinsics, camera_from_world)


def camera_on_ring(index: float, count: int, width: int, height: int) -> Camera:
    """One of ``count`` cameras on a small closed path inside the room, all looking into it."""
    angle = 2 * np.pi * index / count
    eye = np.array([0.9 * np.sin(angle), 0.3 * np.cos(2 * angle), 0.5 * np.cos(angle) - 0.3])
    forward = np.array([0.5 * np.sin(2 * angle), 0.1, 5.0]) - eye
    forward /= np.linalg.norm(forward)
    right = np.cross([0, 1, 0], forward)
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    camera_from_world = np.eye(4)
    camera_from_world[:3, :3], camera_from_world[:3, 3] = rotation, -rotation @ eye
    return Camera(str(index), (width, height), camera(width, height).intrinsics, camera_from_world)


def from_values(
    means: np.ndarray, scales: np.ndarray, quaternions: np.ndarray, opacities: np.ndarray, sh: np.ndarray
) -> Gaussians:
    """Gaussians from scales and opacities as they act; logits are cut at ±20."""
    opacities = np.clip(np.asarray(opacities, np.float64), 2e-9, 1 - 2e-9)
    with np.errstate(divide="ignore"):
        return Gaussians(
            means, quaternions, np.log(np.asarray(scales, np.float64)), np.log(opacities / (1 - opacities)), sh
        )


def room(count: int, seed: int) -> Gaussians:
    """Walls, blobs and a few floaters of flat anisotropic Gaussians as large as their spacing; about half are in view
    of ``camera``."""
    rng = np.random.default_rng(seed)
    on_blobs, floating = int(0.45 * count), int(0.03 * count)
    on_walls = count - on_blobs - floating
    normals = np.array([(0, 1, 0), (0, -1, 0), (1, 0, 0), (-1, 0, 0), (0, 0, -1)], float)
    areas = np.array([81, 81, 36, 36, 36], float)
    wall = rng.choice(5, on_walls, p=areas / areas.sum())
    walls = rng.uniform((-4.5, -2, -1.5), (4.5, 2, 7.5), (on_walls, 3))
    for index, (axis, value) in enumerate(((1, -2), (1, 2), (0, -4.5), (0, 4.5), (2, 7.5))):
        walls[wall == index, axis] = value
    centres = rng.uniform((-2.5, -1, 2), (2.5, 1.2, 6), (14, 3))
    radii = rng.uniform((0.2, 0.4, 0.2), (0.5, 0.9, 0.5), (14, 3))
    blob = rng.integers(0, 14, on_blobs)
    directions = rng.normal(size=(on_blobs, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    means = np.concatenate(
        [walls, centres[blob] + directions * radii[blob], rng.uniform((-2, -1.5, 1), (2, 1.5, 6), (floating, 3))]
    )
    facing = np.concatenate([normals[wall], directions / radii[blob], rng.normal(size=(floating, 3))])
    wall_spacing = np.sqrt(areas.sum() / on_walls)
    blob_spacing = np.sqrt(4 * np.pi * (radii.prod(axis=1) ** (2 / 3)).sum() / max(1, on_blobs))
    spacing = np.concatenate(
        [np.full(on_walls, wall_spacing), np.full(on_blobs, blob_spacing), np.full(floating, wall_spacing)]
    )
    scales = 0.55 * spacing[:, None] * np.exp(rng.normal(0, 0.55, (count, 3)))
    scales[:, 2] *= 0.12
    opacities = np.where(rng.random(count) < 0.5, rng.uniform(0.6, 0.995, count), rng.uniform(0.01, 0.5, count))
    sh = rng.normal(0, 0.12, (count, 16, 3))
    sh[:, 0] = rng.normal(0.3, 0.8, (count, 3))
    shuffled = rng.permutation(count)
    quaternions = _facing(facing + 0.15 * rng.normal(size=facing.shape), rng)
    return from_values(means, scales, quaternions, opacities, sh).take(shuffled)


def hard(count: int, seed: int) -> Gaussians:
    """Needles 200:1, frame-covering, behind, at and grazing the near plane, opacities near 0 and 1, sub-pixel, any
    norms."""
    rng = np.random.default_rng(seed)
    share = count // 10
    parts: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []

    def in_view(n: int, near: float = 1, far: float = 8) -> np.ndarray:
        z = rng.uniform(near, far, n)
        return np.stack([rng.uniform(-0.6, 0.6, n) * z, rng.uniform(-0.35, 0.35, n) * z, z], axis=1)

    def sizes(n: int, log_mean: float, log_sigma: float) -> np.ndarray:
        return np.exp(rng.normal(log_mean, log_sigma, (n, 3)))

    parts.append((in_view(2 * share), sizes(2 * share, -4, 0.5) * [200, 1, 1], rng.uniform(0.2, 0.99, 2 * share)))
    parts.append((in_view(share // 4, 2, 6), rng.uniform(2, 8, (share // 4, 3)), rng.uniform(0.02, 0.3, share // 4)))
    parts.append((in_view(share) * [1, 1, -1], sizes(share, -2, 0.5), rng.uniform(0.1, 0.9, share)))
    parts.append((in_view(share, -0.15, 0.15), sizes(share, -4, 0.8), rng.uniform(0.1, 0.9, share)))
    z = rng.uniform(0.012, 0.2, share)
    grazing = np.stack([rng.uniform(-3, 3, share) * z, rng.uniform(-3, 3, share) * z, z], axis=1)
    parts.append((grazing, sizes(share, -5, 1), rng.uniform(0.1, 0.9, share)))
    parts.append((in_view(share), sizes(share, -3, 0.5), rng.uniform(0, 0.006, share)))
    parts.append((in_view(share, 4, 8), sizes(share, -2.5, 0.5), 1 - 10.0 ** rng.uniform(-7, -3, share)))
    parts.append((in_view(2 * share), sizes(2 * share, -9, 1.5), rng.uniform(0.1, 0.99, 2 * share)))
    rest = count - sum(len(means) for means, _, _ in parts)
    parts.append((in_view(rest), sizes(rest, -3, 1), rng.uniform(0.05, 0.95, rest)))
    means, scales, opacities = (np.concatenate(column) for column in zip(*parts, strict=True))
    quaternions = rng.normal(size=(count, 4)) * 10.0 ** rng.uniform(-3, 3, (count, 1))
    sh = rng.normal(0, 0.15, (count, 16, 3))
    sh[:, 0] = rng.normal(0.2, 0.8, (count, 3))
    return from_values(means, scales, quaternions, opacities, sh).take(rng.permutation(count))


def _facing(normals: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Quaternions (w, x, y, z) that turn +z to ``normals`` after a random turn about it."""
    unit = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    tilt = np.stack([1 + unit[:, 2], -unit[:, 1], unit[:, 0], 0 * unit[:, 0]], axis=1)
    tilt[unit[:, 2] < -1 + 1e-6] = [0, 1, 0, 0]
    w1, x1, y1, z1 = (tilt / np.linalg.norm(tilt, axis=1, keepdims=True)).T
    angle = rng.uniform(0, np.pi, len(unit))
    w2, z2 = np.cos(angle), np.sin(angle)
    return np.stack([w1 * w2 - z1 * z2, x1 * w2 + y1 * z2, y1 * w2 - x1 * z2, w1 * z2 + z1 * w2], axis=1)
