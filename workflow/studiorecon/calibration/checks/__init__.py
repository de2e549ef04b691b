# SPDX-License-Identifier: Apache-2.0
"""What is looked at before a long run: ``sanity`` of the files, ``clocks``, ``coverage``; what refinement would make of
the cameras on people (``refined``) and on the room's straight ``edges``; the verdict and what to do about it
(``advice``), and the ``doctor_page`` that says so. In come a calibration, what people say of it and pictures of the
room; out come sentences.
"""
