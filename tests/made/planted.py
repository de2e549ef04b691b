# SPDX-License-Identifier: Apache-2.0
"""What tests of planted and their neighbours share."""

from __future__ import annotations

from pathlib import Path

import yaml
from studiorecon.configuration.settings import load
from studiorecon.survey.effect_decisions import Settings

ROOT = Path(__file__).resolve().parents[2]


SETTINGS = load(Settings, yaml.safe_load((ROOT / "config/config.yaml").read_text())["survey"], "survey")
