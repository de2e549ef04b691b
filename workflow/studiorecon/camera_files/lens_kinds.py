# SPDX-License-Identifier: Apache-2.0
"""The lens model behind a name, and the coefficients of each: one table for every format.

A name that is not in the table is refused: with a wrong model, a picture's edge would silently be off by tens of
pixels.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from studiorecon.errors import UserError
from studiorecon.scene.user_values import numbers, short_text

if TYPE_CHECKING:
    from jaxtyping import Num

# Names in upper case without separators. OpenCV's model contains the simpler ones of COLMAP, nerfstudio and ROS, and
# its fisheye (Kannala and Brandt's) contains theirs.
_OPENCV = {
    "OPENCV", "FULLOPENCV", "PINHOLE", "SIMPLEPINHOLE", "SIMPLERADIAL", "RADIAL", "PERSPECTIVE", "PLUMBBOB",
    "RATIONALPOLYNOMIAL", "BROWN", "BROWNCONRADY", "RADTAN", "STANDARD",
}  # fmt: skip
_FISHEYE = {
    "OPENCVFISHEYE", "FISHEYE", "SIMPLEFISHEYE", "SIMPLERADIALFISHEYE", "RADIALFISHEYE", "EQUIDISTANT",
    "KANNALABRANDT", "KANNALABRANDT4",
}  # fmt: skip
# Entries that name the model, and those that mark a fisheye, without case and separators.
_MODELS = {"cameramodel", "lensmodel", "distortionmodel", "projectionmodel", "model"}
_FLAGS = {"isfisheye", "fisheye", "fisheyemodel"}
_SAYS = {"TRUE": True, "1": True, "FALSE": False, "0": False}
# Possible lengths of OpenCV's lists; further numbers (thin prism, tilt) must be zero.
_COUNTS = {"opencv": (0, 1, 2, 4, 5, 8), "fisheye": (0, 1, 2, 3, 4)}
_MAX = {"opencv": 8, "fisheye": 4}


def canonical_lens_model(name: object, where: str) -> str:
    """``"opencv"`` or ``"fisheye"``; raises UserError for a name that is neither."""
    plain = _plain(name)
    if plain in _OPENCV:
        return "opencv"
    if plain in _FISHEYE:
        return "fisheye"
    raise UserError(
        f"{where}: its lens is {short_text(str(name))}, which is not supported; undistort the pictures with the "
        "program "
        "that wrote the file, or calibrate with OPENCV or OPENCV_FISHEYE"
    )


def _plain(name: object) -> str:
    return re.sub(r"[^A-Z0-9]", "", str(name).upper())


def lens_model(table: Mapping[str, Any], where: str) -> str:
    """The lens model in the entries of ``table``, ``"opencv"`` without one.

    Raises UserError for an unknown name, and for entries that contradict each other.
    """
    described = {}
    for key, value in table.items():
        plain = _plain(key).lower()
        if plain in _FLAGS and value is not None:
            if _plain(value) not in _SAYS:
                raise UserError(f"{where}: {key} is {short_text(value)}; it must be true or false")
            described[key] = "fisheye" if _SAYS[_plain(value)] else "opencv"
        elif plain in _MODELS and isinstance(value, str):
            described[key] = canonical_lens_model(value, where)
    if len(set(described.values())) > 1:
        listed = " and ".join(f"{key} {short_text(table[key])}" for key in described)
        raise UserError(f"{where}: {listed} are two different lenses; keep the right one")
    return next(iter(described.values()), "opencv")


def coefficients(model: str, values: object, where: str) -> Num[np.ndarray, " C"]:
    """k1 k2 p1 p2 k3 k4 k5 k6 of the model opencv or k1 k2 k3 k4 of fisheye; missing ones are 0.

    Raises UserError unless ``values`` is a list of numbers of a length that the model can have.
    """
    given = numbers([] if values is None else values, f"{where}: its distortion").reshape(-1)
    most = _MAX[model]
    if given[most:].any():
        raise UserError(
            f"{where}: {len(given)} distortion coefficients are not supported by the model {model}, which has {most}; "
            "calibrate without thin prism and tilt, or name the right model"
        )
    if len(given) <= most and len(given) not in _COUNTS[model]:
        raise UserError(
            f"{where}: {len(given)} distortion coefficients; the model {model} has "
            f"{', '.join(map(str, _COUNTS[model][:-1]))} or {most}, in OpenCV's order"
        )
    full = np.zeros(most)
    full[: min(len(given), most)] = given[:most]
    return full
