# SPDX-License-Identifier: Apache-2.0
"""Groups tracks of several cameras into persons; inputs are detections and cameras, outputs are groups with reasons.

``affinity`` (of pairs, by rays and ``postures``) → ``grouping`` (each ``group`` chosen whole, joined over ``gaps``) →
``terms`` and ``picture_terms`` (log-likelihood ratios) → ``acceptance`` (which groups are people) →
``rejected_people`` (the other groups).
"""
