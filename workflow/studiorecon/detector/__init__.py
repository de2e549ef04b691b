# SPDX-License-Identifier: Apache-2.0
"""The embedded detector: MoveNet finds people, BlazePose places them. In come a camera's frames; out come people with
33 landmarks, masks and a track.

``movenet`` finds everybody in a picture, ``crops`` cuts each one out, ``blazepose`` places them, ``second_network`` a
network of the user's own behind it (``top_down``: of one person, ``one_stage``: of everybody), ``network_files`` opens
both, ``looking`` is all of that for one picture, ``film_rotation`` says how a film is turned, ``following`` goes
through a camera's frames.
"""

import os

# From 1.32 on ONNX Runtime tells Microsoft of its use, and keeps a file in the user's cache, unless this is set before
# it is loaded. Nothing here leaves the machine.
os.environ["ORT_DISABLE_TELEMETRY"] = "1"
