# SPDX-License-Identifier: Apache-2.0
"""Groups tracks of several cameras into persons; inputs are detections and cameras, outputs are groups with reasons.

``track_pairs`` (distances of pairs, in position and by ``postures``) → ``grouping`` (groups chosen whole) →
``picture_change``, ``image_evidence``, ``proportions``, ``false_positives`` and ``acceptance`` (which groups are
people) → ``rejected_people`` (the other groups). The paper's way instead: ``affinity`` and ``reference_view``.
``corrected_identities``: identities as the user has them.
"""
