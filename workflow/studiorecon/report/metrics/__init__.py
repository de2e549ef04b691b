# SPDX-License-Identifier: Apache-2.0
"""Measures. In: results, photos and truth; out: numbers with intervals.

* pictures: ``measures``, ``distance`` (LPIPS), ``folders`` (of any method), ``films`` (first frame of each camera),
  ``truth`` (of a synthetic studio), ``estimated`` (regions by the run itself);
* cameras: ``overlap`` of the training cameras;
* people: ``bodies``, ``identities`` and ``identity_scores``, ``pck``, ``jitter``;
* ``bootstrap``: intervals; ``definitions``: the meaning of every number.
"""
