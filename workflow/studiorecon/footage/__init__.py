# SPDX-License-Identifier: Apache-2.0
"""Moving and still pictures as files: the user's footage, this project's working video, depth and plates.

Inputs are paths; outputs are upright frames in order, or files that are complete or absent.

* ``source``: a camera's footage as the user has it, video or folder of pictures: the only place that opens it;
* ``chapters``: several files of one recording as one film;
* ``kinds``: which files are films; ``container``: an opened film, whatever the encoding of its tags;
* ``timing``: number and times of the frames that a decoder shows; ``stored_format``: one moment, BT.709, square pixels,
  upright;
* ``frames``: the pictures, all or some of them; ``sound_track``: the first sound that can be decoded;
* ``lens_metadata``: the focal length in a file's metadata; ``duplicate_films``: detects a film that was given twice;
* ``video``: working video and films, written, and read from any frame on; ``streams``: several written in parallel;
* ``exr``: depth maps; ``stills``: clean plates.
"""
