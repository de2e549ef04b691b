# SPDX-License-Identifier: Apache-2.0
"""Effects of a trained scene: the decisions of training and films are combined in one table."""

from __future__ import annotations

import json
from dataclasses import asdict, replace
from pathlib import Path

from studiorecon.configuration.settings import load
from studiorecon.report import audit as step
from studiorecon.report.audit import decide_appearance_network
from studiorecon.scene.decisions import Decision, read_decisions, write_decisions
from studiorecon.scene.effects import ENHANCEMENT, INJECTION
from studiorecon.scene.files import write_npz


def test_who_drifts_most_speaks_for_all_and_who_is_unmeasured_for_nobody() -> None:
    drift = Decision("temporal_appearance", "s", 0.3, (0.25, 0.35), 0.1, "on", "p1's shirt")
    still = replace(drift, value=0.02, interval=(0.01, 0.03), verdict="off", reason="p0 is of stone")
    found = decide_appearance_network({"p0": still, "p1": drift, "p2": None}, 0.1)
    assert (found.verdict, found.reason, set(found.detail)) == ("on", "p1's shirt", {"p0", "p1"})
    assert decide_appearance_network({"p0": still}, 0.1).verdict == "off"
    assert decide_appearance_network({"p0": replace(still, verdict="on")}, 0.1).verdict == "on", (
        "what training did, not once more"
    )
    assert found.used_by
    assert decide_appearance_network({"p0": None}, 0.1).verdict == "undetermined"
    assert decide_appearance_network({}, 0.1).verdict == "undetermined"


def test_the_step_decides_and_can_be_forced(tmp_path: Path, default_settings) -> None:
    drift = Decision("temporal_appearance", "s", 0.3, (0.25, 0.35), 0.1, "on", "why")
    write_npz(tmp_path / "p0.npz", {"decision": json.dumps(asdict(drift))})
    calm = INJECTION.decide(0.01, (0.0, 0.02), "calm")
    reported = {"orbit": [ENHANCEMENT.decide(0.3, (0.2, 0.4), "gains"), calm], "still": [calm], "elsewhere": []}
    for film, decisions in reported.items():
        write_decisions(tmp_path / f"{film}.json", decisions)
    settings = load(step.Settings, default_settings("survey"), "survey")
    files = {
        "avatars": [tmp_path / "p0.npz"],
        "films": [tmp_path / f"{film}.json" for film in reported],
        "decisions": tmp_path / "report/audit.json",
    }
    step.run(settings, **files)
    found = {effect: d.verdict for effect, d in read_decisions(files["decisions"]).items()}
    assert found == {"temporal_appearance": "on", "enhancement": "on", "injection": "off"}
    step.run(replace(settings, force={"temporal_appearance": "off"}), **{**files, "films": []})
    made = read_decisions(files["decisions"])
    assert (made["temporal_appearance"].verdict, made["temporal_appearance"].forced) == ("off", True)
    assert (made["enhancement"].verdict, made["injection"].verdict) == ("undetermined", "undetermined")
