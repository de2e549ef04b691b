# SPDX-License-Identifier: Apache-2.0
"""The embedded detector of people: BlazePose on full pictures. In come a camera's frames; out come people with 33
landmarks, masks and a track.

``windows`` says where in a picture somebody is looked for, ``crops`` cuts that out, ``blazepose`` runs the two
networks there, ``second_network`` a network of the user's own behind them (``top_down``: of one person, ``one_stage``:
of everybody), ``network_files`` opens both, ``looking`` finds everybody in one picture, ``film_rotation`` says how a
film is turned, ``following`` goes through a camera's frames.
"""

import os

# From 1.32 on ONNX Runtime tells Microsoft of its use, and keeps a file in the user's cache, unless this is set before
# it is loaded. Nothing here leaves the machine.
os.environ["ORT_DISABLE_TELEMETRY"] = "1"
