# SPDX-License-Identifier: Apache-2.0
"""Jobs side by side: by hand where that can be done, and between bounds that hold for any schedule that never idles."""

from __future__ import annotations

import numpy as np
import pytest
from studiorecon.plan.schedule import WAITS_FOR, finished_s


def test_a_rule_waits_only_for_rules_before_it() -> None:
    names = list(WAITS_FOR)
    for place, rule in enumerate(names):
        assert set(WAITS_FOR[rule]) <= set(names[:place])


def test_jobs_of_a_rule_share_the_cores_and_the_next_waits_for_all_of_them() -> None:
    jobs = {"depth_sweep": [4.0, 2.0, 2.0], "depth_box": [1.0]}
    assert finished_s(jobs, 1) == 9.0
    assert finished_s(jobs, 2) == 5.0
    assert finished_s(jobs, 3) == 5.0


def test_what_most_waits_for_goes_first() -> None:
    # Films of what was held out can wait; the room cannot.
    jobs = {"cameras_refine": [1.0], "cameras_held_out": [5.0, 5.0], "depth_sweep": [5.0], "depth_box": [5.0]}
    assert finished_s(jobs, 1) == 21.0
    assert finished_s(jobs, 2) == 11.0


def test_what_a_run_lacks_is_passed_through() -> None:
    assert finished_s({"cameras_refine": [2.0], "people_fit": [3.0]}, 4) == 5.0
    assert finished_s({"people_overlay": [3.0], "humans_train": [2.0]}, 4) == 3.0
    assert finished_s({"people_fit": []}, 4) == finished_s({}, 1) == 0.0


@pytest.mark.parametrize("seed", range(20))
def test_no_schedule_is_shorter_than_its_bounds_or_longer_than_grahams(seed: int) -> None:
    rng = np.random.default_rng(seed)
    chosen = [rule for rule in WAITS_FOR if rng.random() < 0.8]
    jobs = {rule: rng.exponential(3.0, int(rng.integers(1, 6))).tolist() for rule in chosen}
    work, chain, cores = sum(map(sum, jobs.values())), finished_s(jobs, 10_000), int(rng.integers(1, 5))
    took = finished_s(jobs, cores)
    assert max(work / cores, chain) - 1e-9 <= took
    # Graham, SIAM J. Appl. Math. 17, 1969.
    assert took <= work / cores + chain * (1 - 1 / cores) + 1e-9
