# SPDX-License-Identifier: Apache-2.0
"""The embedded detector: MoveNet finds people, BlazePose places them. In come a camera's frames; out come people with
33 landmarks, masks and a track.

* ``movenet`` finds people in a whole picture, ``crops`` cuts one out, ``blazepose`` places landmarks in the crop;
* ``frame_detection`` runs them on one picture, ``tracking`` on successive ones, ``film_detection`` on stretches of a
  film, ``film_search`` stretch by stretch;
* ``second_network`` adds a network of the user (``top_down``: one person a crop, ``one_stage``: the whole picture);
  ``network_files`` opens both;
* ``hand_landmarks`` places the fingers of a hand at the end of an arm;
* ``film_rotation`` measures whether a film is turned.
"""
