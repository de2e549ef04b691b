# SPDX-License-Identifier: Apache-2.0
"""Views between the training cameras, for the background to train on. In come plates, depth and cameras; out come
pictures with the support that photos give them.

``path`` (where from) → ``synthesize`` (``forward``: photos carried through their depth). By a network instead:
``request``, ``generate``, ``fitted``, with ``frame`` for its picture size, ``first_moment`` for the people it is shown
and ``people`` for another network that finds them in its views.
``warp_settings``: settings of several steps.
"""
