# SPDX-License-Identifier: Apache-2.0
"""Draws films of the scene. In: background, people, objects and light; out: pictures, depth and truth maps per shot.

* steps: ``light`` (the room's light from shadows), ``shot`` (a film), ``layers`` (a film split into layers), ``shade``
  (the shadows alone, for the player);
* the definition of a shot: ``kinds``, ``shots``, ``look_at_targets``, and its path: ``orbit``, ``keyframes``,
  ``moves``, ``path_file``, combined by ``planning``;
* drawing: ``composite``, ``replacement``, ``shading`` with ``room_light``, ``area_lights`` and ``occlusion``, by
  ``composite_renderer``; ``statistics`` measures the result.

``draw_settings``: settings of several steps.
"""
