# SPDX-License-Identifier: Apache-2.0
"""Measures. In come results, photos and truth; out come numbers with intervals.

* pictures: ``measures``, ``distance`` (LPIPS), ``folders`` (any method's), ``films`` (where a camera's
  view begins), ``truth`` (a synthetic studio's);
* cameras: ``overlap``, of those that are trained on;
* people: ``bodies``, ``identities`` and ``identity_scores``, ``pck``, ``jitter``;
* ``rendered_effects``: what the audit decides; ``bootstrap``: intervals; ``definitions``: what every number means.
"""
