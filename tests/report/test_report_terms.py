# SPDX-License-Identifier: Apache-2.0
"""The licence section: the strictest terms decide, every network has its line, and external files are marked."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import yaml
from studiorecon.report.sections.licences import licences, verdict


@pytest.fixture
def configuration(root: Path) -> dict:
    return yaml.safe_load((root / "config/config.yaml").read_text())


def test_a_run_without_networks_says_so(configuration: dict, root: Path) -> None:
    assert verdict(configuration) == "yes"
    page = licences(configuration, root / "resources/licences")
    assert "No upstream network was used" in page
    assert "makehuman-cc0.txt" in page


@pytest.mark.parametrize(
    ("source", "expected"),
    [("moge", "yes"), ("precomputed", "unknown"), ("pi3", "no")],
    ids=lambda v: v,
)
def test_the_strictest_terms_decide(configuration: dict, root: Path, source: str, expected: str) -> None:
    configuration["depth"]["source"] = source
    assert verdict(configuration) == expected
    page = licences(configuration, root / "resources/licences")
    assert {"yes": "forbids", "unknown": "check whether their terms", "no": "may not be used commercially"}[
        expected
    ] in page
    assert ("files brought by the user" in page) == (source == "precomputed")


def test_the_line_of_a_network_has_terms_commit_and_checksum(configuration: dict, root: Path, tmp_path: Path) -> None:
    configuration["depth"]["source"], configuration["weights"] = "pi3", str(tmp_path)
    assert "not verified" in licences(configuration, root / "resources/licences")
    pins = {"pi3/model.safetensors": {"sha256": "ab" * 32, "bytes": 1, "modified_ns": 2}}
    (tmp_path / "checksums.json").write_text(json.dumps(pins))
    page = licences(configuration, root / "resources/licences")
    for word in ("Pi3", "CC BY-NC 4.0", "BSD-3-Clause", "9fa3ddb", "model.safetensors abababababab", "depth.source"):
        assert word in page
