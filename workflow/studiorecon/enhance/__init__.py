# SPDX-License-Identifier: Apache-2.0
"""Enhances films without flicker. In: renders; out: repaired pictures, each consistent with those before it.

In reading order: ``recursive``, outside the stages (a clip, picture by picture), ``backends`` (enhancers of one
picture), ``photos`` (the training photos with their renders), ``trial`` (whether this film needs enhancement). Step:
``shot`` (a film of a scene).
``injection_settings``: settings of several steps.
"""
