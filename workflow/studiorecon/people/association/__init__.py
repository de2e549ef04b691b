# SPDX-License-Identifier: Apache-2.0
"""Tracks of several cameras → persons. In come detections and cameras; out come groups of tracks, each with a reason.

``track_pairs`` (how far apart any two are, in place and by ``postures``) → ``grouping`` (groups chosen whole) →
``picture_change``, ``confirmation``, ``proportions``, ``ghosts`` and ``acceptance`` (which of them are people) →
``left_out`` (who is not among them). The paper's way instead: ``affinity`` and
``reference_view``. ``corrected``: identities as the user has them.
"""
