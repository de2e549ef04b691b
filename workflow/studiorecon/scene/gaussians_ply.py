# SPDX-License-Identifier: Apache-2.0
"""Gaussians in the PLY layout of the original 3D Gaussian splatting code, which every viewer reads.

Binary little endian, float32: x y z nx ny nz f_dc_0..2 f_rest_0..(3k−1) opacity scale_0..2 rot_0..3, where f_rest is
channel-major (all red coefficients, then green, then blue), opacity is a logit, scales are logarithms and rot is (w, x,
y, z).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from studiorecon.errors import UserError
from studiorecon.progress import say, warn
from studiorecon.scene.files import atomic_path
from studiorecon.scene.gaussians import Gaussians
from studiorecon.scene.step_files import CURE
from studiorecon.scene.user_files import read_bytes

_FORMAT = "format binary_little_endian 1.0"
_HEADER_LIMIT = 1 << 16


def property_names(bands: int) -> list[str]:
    """The PLY properties of Gaussians with ``bands`` harmonics per channel, in file order."""
    rest = [f"f_rest_{i}" for i in range(3 * (bands - 1))]
    dc = ["f_dc_0", "f_dc_1", "f_dc_2"]
    rotation = [f"rot_{i}" for i in range(4)]
    return ["x", "y", "z", "nx", "ny", "nz", *dc, *rest, "opacity", "scale_0", "scale_1", "scale_2", *rotation]


def write_ply(path: Path, gaussians: Gaussians) -> None:
    """Write the Gaussians, completely or not at all."""
    n, bands = gaussians.count, gaussians.sh.shape[1]
    rest = gaussians.sh[:, 1:].transpose(0, 2, 1).reshape(n, 3 * (bands - 1))
    columns = [
        gaussians.means_m,
        np.zeros((n, 3), np.float32),
        gaussians.sh[:, 0],
        rest,
        gaussians.logit_opacities[:, None],
        gaussians.log_scales,
        gaussians.quaternions,
    ]
    header = [
        "ply",
        _FORMAT,
        f"element vertex {n}",
        *(f"property float {name}" for name in property_names(bands)),
        "end_header",
        "",
    ]
    with atomic_path(path) as partial, open(partial, "wb") as file:
        file.write("\n".join(header).encode("ascii"))
        file.write(np.ascontiguousarray(np.concatenate(columns, axis=1), dtype="<f4").tobytes())


def read_ply(path: Path, remedy: str = CURE) -> Gaussians:
    """The Gaussians of a PLY; properties may come in any order.

    Logs unused properties and the number of Gaussians with a value that is not a number: they are never drawn. Raises
    UserError with the file's name and ``remedy`` for any other layout.
    """
    try:
        return _gaussians(path, read_bytes(path, remedy=remedy))
    except ValueError as error:
        raise UserError(f"{path} {error}; {remedy}") from None


def _gaussians(path: Path, data: bytes) -> Gaussians:
    """The Gaussians of ``data``; raises ValueError with the rest of a sentence that starts with the file's name."""
    end = data.find(b"end_header", 0, _HEADER_LIMIT)
    body = data.find(b"\n", end) + 1
    if not data.startswith(b"ply") or end < 0 or body == 0:
        raise ValueError("is not a PLY file (no header)")
    count, names = _header(data[:end].decode("ascii", errors="replace"))
    bands = _bands(names)
    held, row = len(data) - body, 4 * len(names)
    if held < count * row:
        raise ValueError(f"is cut off: it promises {count} Gaussians and holds {held // row}")
    if held > count * row:
        raise ValueError(f"holds {held - count * row} bytes more than the {count} Gaussians it promises")
    table = np.frombuffer(data, "<f4", count * len(names), body).reshape(count, len(names)).astype(np.float32)
    column = {name: i for i, name in enumerate(names)}
    known = property_names(bands)
    if extra := [name for name in names if name not in known]:
        say(
            f"{path.name}: {', '.join(extra)} {'is' if len(extra) == 1 else 'are'} not "
            "used, the 3DGS layout has no such property"
        )
    numbers = table[:, [column[name] for name in known if name not in ("nx", "ny", "nz", "opacity")]]
    # An infinite logit is an opacity of exactly 0 or 1, which some writers store.
    bad = int((~np.isfinite(numbers).all(axis=1) | np.isnan(table[:, column["opacity"]])).sum())
    if bad:
        warn(f"{path.name}: {bad} of {count} Gaussians hold a value that is not a number and are not drawn")

    def columns(*wanted: str) -> np.ndarray:
        return table[:, [column[name] for name in wanted]]

    sh = np.empty((count, bands, 3), np.float32)
    sh[:, 0] = columns("f_dc_0", "f_dc_1", "f_dc_2")
    if bands > 1:
        sh[:, 1:] = (
            columns(*(f"f_rest_{i}" for i in range(3 * (bands - 1)))).reshape(count, 3, bands - 1).transpose(0, 2, 1)
        )
    return Gaussians(
        columns("x", "y", "z"),
        columns("rot_0", "rot_1", "rot_2", "rot_3"),
        columns("scale_0", "scale_1", "scale_2"),
        columns("opacity")[:, 0],
        sh,
    )


def _header(text: str) -> tuple[int, list[str]]:
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    if _FORMAT not in lines:
        raise ValueError("is not a binary little endian PLY in the 3DGS layout")
    elements = [line.split() for line in lines if line.startswith("element")]
    if [e[1:2] for e in elements] != [["vertex"]] or not elements[0][2:] or not elements[0][2].isdigit():
        raise ValueError("must hold one element 'vertex' and nothing else (is it a mesh?)")
    properties = [line.split() for line in lines if line.startswith("property")]
    for entry in properties:
        if len(entry) != 3 or entry[1] not in ("float", "float32"):
            raise ValueError(f"has the property {' '.join(entry[1:])!r}; the 3DGS layout holds floats only")
    return int(elements[0][2]), [entry[2] for entry in properties]


def _bands(names: list[str]) -> int:
    rest = sum(name.startswith("f_rest_") for name in names)
    bands = {0: 1, 9: 4, 24: 9, 45: 16}.get(rest)
    if bands is None:
        raise ValueError(f"has {rest} f_rest properties; spherical harmonics of degree 0 to 3 have 0, 9, 24 or 45")
    missing = [name for name in property_names(bands) if name not in names and name not in ("nx", "ny", "nz")]
    if missing:
        raise ValueError(f"has no property {missing[0]!r}; it is not a Gaussian PLY of the 3DGS layout")
    if twice := [name for name in dict.fromkeys(names) if names.count(name) > 1]:
        raise ValueError(f"has the property {twice[0]!r} twice; delete one of them")
    return bands
