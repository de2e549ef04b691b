# SPDX-License-Identifier: Apache-2.0
"""Checks of a calibration before a long run; inputs are cameras, people and pictures of the room, outputs are
sentences.

``sanity`` checks the files, ``coverage`` follows. ``refined`` and ``edges`` predict how people and the
room's straight edges would refine the cameras. ``examination`` does all of them,
``advice`` gives the verdict and remedies, ``doctor_page`` shows them.
"""
