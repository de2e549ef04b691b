# SPDX-License-Identifier: Apache-2.0
"""Where to put cameras, before anything is filmed. In come a room and lenses, or finished cameras; out come places,
what they will see, and one picture. Steps: ``place``, ``advise``; below them: ``room``, ``placing``, ``figures``,
``picture``.
"""
