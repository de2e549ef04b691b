# SPDX-License-Identifier: Apache-2.0
"""Films of the scene. In come background, people, things and light; out come pictures, depth and truth maps per shot.

* steps: ``light`` (the room's light from shadows), ``shot`` (a film), ``layers`` (a film taken apart), ``shade`` (the
  shadows alone, for the player);
* what a shot is: ``kinds``, ``shots``, ``subjects``, and its path: ``orbit``, ``keyframes``, ``moves``, ``given``,
  put together by ``planning``;
* what is drawn: ``composite``, ``replacement``, ``shading`` with ``room_light``, ``lamps`` and ``occlusion``, by
  ``canvas``;
  ``statistics`` keeps account.
``draw_settings``: settings of several steps.
"""
