# SPDX-License-Identifier: Apache-2.0
"""Gaussians and their PLY: what goes in comes out, byte for byte where other programs read it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from studiorecon.errors import UserError
from studiorecon.scene.gaussians import Gaussians, concatenate, empty
from studiorecon.scene.gaussians_ply import property_names, read_ply, write_ply
from studiorecon.splatting.cpu.rasterise import Rasteriser

from tests.made.gaussians import camera, room

FIELDS = ("means_m", "quaternions", "log_scales", "logit_opacities", "sh")


def assert_equal(a: Gaussians, b: Gaussians) -> None:
    for name in FIELDS:
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name), err_msg=name)


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
@pytest.mark.parametrize("count", [0, 1, 37])
def test_ply_round_trip_is_exact(tmp_path: Path, degree: int, count: int) -> None:
    gaussians = room(40, 1).take(np.arange(count)).with_sh_degree(degree)
    write_ply(tmp_path / "a.ply", gaussians)
    assert_equal(read_ply(tmp_path / "a.ply"), gaussians)


def test_ply_has_the_layout_of_3dgs(tmp_path: Path) -> None:
    gaussians = room(5, 2)
    write_ply(tmp_path / "a.ply", gaussians)
    header, body = (tmp_path / "a.ply").read_bytes().split(b"end_header\n", 1)
    names = [line.split()[2] for line in header.decode().splitlines() if line.startswith("property")]
    assert names[:9] == ["x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2"]
    assert names[9:54] == [f"f_rest_{i}" for i in range(45)]
    assert names[54:] == ["opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"]
    table = np.frombuffer(body, "<f4").reshape(5, 62)
    # Channel-major: f_rest_15 is the second coefficient of green.
    np.testing.assert_array_equal(table[:, names.index("f_rest_15")], gaussians.sh[:, 1, 1])
    np.testing.assert_array_equal(table[:, names.index("f_rest_2")], gaussians.sh[:, 3, 0])
    np.testing.assert_array_equal(table[:, 3:6], 0)


def test_ply_properties_may_come_in_any_order(tmp_path: Path) -> None:
    gaussians = room(3, 3).with_sh_degree(0)
    write_ply(tmp_path / "a.ply", gaussians)
    body = (tmp_path / "a.ply").read_bytes().split(b"end_header\n", 1)[1]
    names = property_names(1)
    table = np.frombuffer(body, "<f4").reshape(3, len(names))[:, ::-1]
    lines = ["ply", "format binary_little_endian 1.0", "comment made elsewhere", "element vertex 3"]
    lines += [f"property float {name}" for name in names[::-1]] + ["end_header", ""]
    (tmp_path / "b.ply").write_bytes("\n".join(lines).encode() + table.tobytes())
    assert_equal(read_ply(tmp_path / "b.ply"), gaussians)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda data: data[:-40], "cut off"),
        (lambda data: data[:50], "no header"),
        (lambda data: data.replace(b"binary_little_endian", b"ascii"), "binary little endian"),
        (lambda data: data.replace(b"property float rot_3", b"property float rot_x"), "rot_3"),
        (lambda data: data.replace(b"property float x\n", b"property double x\n"), "floats only"),
        (lambda data: data.replace(b"end_header", b"element face 0\nend_header"), "nothing else"),
        (lambda data: data.replace(b"f_rest_44", b"g_rest_44"), "44 f_rest"),
        (
            lambda data: data.replace(b"property float f_rest_44", b"property float f_rest_45"),
            "no property 'f_rest_44'",
        ),
        (lambda data: data.replace(b"property float nz", b"property float ny"), "'ny' twice"),
        (lambda data: data.replace(b"property float nz", b"property uchar red\nproperty float nz"), "uchar red"),
        (lambda data: data + b"\x00" * 248, "248 bytes more"),
        (lambda data: data.replace(b"vertex 4", b"vertex -4"), "one element 'vertex'"),
    ],
)
def test_a_ply_that_is_not_gaussians_is_refused_by_name(tmp_path: Path, change, message: str) -> None:
    write_ply(tmp_path / "a.ply", room(4, 4))
    (tmp_path / "b.ply").write_bytes(change((tmp_path / "a.ply").read_bytes()))
    with pytest.raises(UserError, match=message) as refusal:
        read_ply(tmp_path / "b.ply")
    assert "b.ply" in str(refusal.value)


def with_column(path: Path, name: str, values: np.ndarray) -> None:
    """Adds a float property at the end of every row."""
    header, body = path.read_bytes().split(b"end_header\n", 1)
    table = np.frombuffer(body, "<f4").reshape(len(values), -1)
    path.write_bytes(
        header
        + f"property float {name}\nend_header\n".encode()
        + np.column_stack([table, values]).astype("<f4").tobytes()
    )


def test_a_further_property_is_named_and_changes_nothing(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    gaussians = room(4, 4)
    write_ply(tmp_path / "a.ply", gaussians)
    with_column(tmp_path / "a.ply", "confidence", np.full(4, np.nan))
    assert_equal(read_ply(tmp_path / "a.ply"), gaussians)
    reported = capsys.readouterr().out.splitlines()
    assert len(reported) == 1
    assert "a.ply: confidence is not used" in reported[0]


def test_rows_that_are_not_numbers_are_counted_in_one_sentence_and_not_drawn(
    tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    gaussians, view = room(300, 4), camera(64, 48)
    rows = np.arange(0, 300, 30)
    gaussians.means_m[rows[:4], 1], gaussians.sh[rows[4:7], 9, 2], gaussians.logit_opacities[rows[7:]] = (
        np.nan,
        np.inf,
        np.nan,
    )
    write_ply(tmp_path / "a.ply", gaussians)
    read = read_ply(tmp_path / "a.ply")
    assert_equal(read, gaussians)
    (reported,) = capsys.readouterr().out.splitlines()
    assert "a.ply: 10 of 300 Gaussians hold a value that is not a number" in reported
    rasteriser = Rasteriser(near_m=0.01, threads=1)
    shown = rasteriser.forward(read, view).rgb
    assert 7 <= rasteriser.refused <= 10, "colours are looked at in view only"
    np.testing.assert_array_equal(shown, rasteriser.forward(read.take(np.setdiff1d(np.arange(300), rows)), view).rgb)


def test_every_bit_pattern_survives_the_round_trip(tmp_path: Path) -> None:
    """Denormals, signed zeros, infinities and NaN payloads: the file holds the stored floats, nothing is computed."""
    bits = np.random.default_rng(0).integers(0, 1 << 32, (50, 59), np.uint32).view(np.float32)
    gaussians = Gaussians(bits[:, :3], bits[:, 3:7], bits[:, 7:10], bits[:, 10], bits[:, 11:].reshape(50, 16, 3))
    write_ply(tmp_path / "a.ply", gaussians)
    read = read_ply(tmp_path / "a.ply")
    for name in FIELDS:
        assert getattr(read, name).tobytes() == getattr(gaussians, name).tobytes(), name


def test_a_missing_ply_is_refused_by_name(tmp_path: Path) -> None:
    with pytest.raises(UserError, match=r"no\.ply is missing"):
        read_ply(tmp_path / "no.ply")


def test_concatenate_pads_harmonics_and_keeps_order() -> None:
    one, two = room(4, 5).with_sh_degree(1), room(3, 6)
    both = concatenate([one, empty(0), two])
    assert both.count == 7
    assert both.sh_degree == 3
    np.testing.assert_array_equal(both.sh[:4, :4], one.sh)
    np.testing.assert_array_equal(both.sh[:4, 4:], 0)
    assert_equal(both.take(np.arange(4, 7)), two)


def test_shapes_that_do_not_fit_are_refused() -> None:
    with pytest.raises(ValueError, match="quaternions"):
        Gaussians(np.zeros((2, 3)), np.zeros((3, 4)), np.zeros((2, 3)), np.zeros(2), np.zeros((2, 1, 3)))
    with pytest.raises(ValueError, match="5 coefficients"):
        Gaussians(np.zeros((2, 3)), np.zeros((2, 4)), np.zeros((2, 3)), np.zeros(2), np.zeros((2, 5, 3)))
