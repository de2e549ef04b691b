# SPDX-License-Identifier: Apache-2.0
"""The section on cameras of the report's page."""

from __future__ import annotations

from typing import Any

from studiorecon.report.sections import tables

CONTRADICTED = {"cameras": ["cam1", "<b>"], "off_deg": 2.37, "off_sigmas": 4.8, "believed": False}


def said(edges: dict[str, Any] | None) -> str:
    return tables.cameras_table({} if edges is None else {"edges": edges}, "sheet.png").split("<img")[0]


def test_what_the_room_s_edges_say_stands_before_and_after() -> None:
    moved = said({**CONTRADICTED, "believed": True, "off_after_deg": 0.19, "between_deg": 2.56})
    assert "contradicted the rotation between cam1 and &lt;b&gt; by 2.4°; after refinement by 0.2°" in moved
    assert "±2.6° (95 %)" in moved
    stayed = said(CONTRADICTED)
    assert "2.4°, 4.8 of their" in stayed
    assert "no camera was refined" in stayed
    assert "straight edges" not in said(None)
