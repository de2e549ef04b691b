# SPDX-License-Identifier: Apache-2.0
"""Films that do not flicker: renders go in, repaired pictures come out, each seen together with those before it.

In reading order: ``recursive`` beside the stages (a clip, picture by picture), ``backends`` (what improves a picture),
``photos`` (the training photos beside their renders), ``trial`` (does this film call for any of it?). Steps: ``shot``
(a film of a scene), ``folder`` (pictures of anybody), ``sheet`` (how one picture was made), ``comparison`` (before and
after). ``injection_settings``: settings of several steps.
"""
