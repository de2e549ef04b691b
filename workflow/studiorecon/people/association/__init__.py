# SPDX-License-Identifier: Apache-2.0
"""Tracks of several cameras → persons. In come detections and cameras; out come groups of tracks, each with a reason.

``track_pairs`` (how far apart any two are, in place and by ``postures``) → ``grouping`` (groups chosen whole) →
``picture_change``, ``image_evidence``, ``proportions``, ``false_positives`` and ``acceptance`` (which of them are
people) → ``rejected_people`` (who is not among them). The paper's way instead: ``affinity`` and
``reference_view``. ``corrected``: identities as the user has them.
"""
