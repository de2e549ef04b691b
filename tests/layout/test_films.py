# SPDX-License-Identifier: Apache-2.0
"""What a film may say and what holds where it does not stand once, with its kind; the schema and the prose follow."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import pytest
import yaml
from studiorecon.render.keyframes import CameraKey, FreeKey
from studiorecon.render.kinds import EXTRA_OPTIONS, KINDS

ROOT = Path(__file__).resolve().parents[2]
SCHEMA = yaml.safe_load((ROOT / "workflow/schemas/config.schema.yaml").read_text())


def needed(kind: type) -> set[str]:
    return {field.name for field in dataclasses.fields(kind) if field.default is dataclasses.MISSING}


def test_the_schema_knows_every_kind() -> None:
    assert set(
        SCHEMA["properties"]["render"]["properties"]["shots"]["additionalProperties"]["properties"]["kind"]["enum"]
    ) == set(KINDS)


@pytest.mark.parametrize("name", KINDS)
def test_the_schema_of_a_kind_is_its_dataclass(name: str) -> None:
    described, kind = SCHEMA["$defs"][name], KINDS[name]
    besides = set() if name == "heldout" else set(EXTRA_OPTIONS)
    assert set(described["properties"]) == {field.name for field in dataclasses.fields(kind)} | besides
    assert set(described["required"]) == needed(kind)
    assert needed(kind) <= {"kind", "file"}, "a film needs only its kind, and a path its file"


def test_the_schema_of_a_key_is_its_dataclass() -> None:
    key = SCHEMA["$defs"]["spline"]["properties"]["keys"]["items"]
    assert set(key["properties"]) == {field.name for kind in (CameraKey, FreeKey) for field in dataclasses.fields(kind)}
    assert {*key["required"], *(name for option in key["oneOf"] for name in option["required"])} == needed(
        CameraKey
    ) | needed(FreeKey)


@pytest.mark.parametrize("name", [name for name in KINDS if name != "heldout"])
def test_the_prose_has_every_default(name: str) -> None:
    (row,) = [line for line in (ROOT / "config/README.md").read_text().splitlines() if line.startswith(f"| `{name}` |")]
    for field in dataclasses.fields(KINDS[name]):
        if field.name in ("kind", "keys", "file"):
            continue
        default = list(field.default) if isinstance(field.default, tuple) else field.default
        written = '""' if default == "" else default
        assert f"`{field.name}: {written}`" in row, (
            f"config/README.md does not say that {field.name} of {name} is {written}"
        )
