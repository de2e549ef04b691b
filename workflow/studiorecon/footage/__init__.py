# SPDX-License-Identifier: Apache-2.0
"""Moving and still pictures as files: the user's footage, this project's working video, depth and plates.

In come paths; out come frames, the right way up, one after the other, or files that are complete or absent.

* ``source``: a camera's footage as the user has it, video or folder of pictures: the only opener there is;
* ``chapters``: several files of one recording as one film;
* ``kinds``: which files are films; ``container``: a film opened, whatever its tags are of;
* ``timing``: how many frames a decoder shows, and when; ``as_shown``: one moment, BT.709, square pixels, upright;
* ``frames``: the pictures, all or some of them; ``sound_track``: the first sound that can be decoded;
* ``told_lens``: the focal length that a file itself tells; ``alike``: one film that was given twice;
* ``video``: working video and films, written, and read from any frame on; ``streams``: several written side by side;
* ``exr``: depth maps; ``stills``: clean plates.
"""
