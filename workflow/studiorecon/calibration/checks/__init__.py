# SPDX-License-Identifier: Apache-2.0
"""What is looked at before a long run: ``sanity`` of the files, ``clocks``, ``coverage``; the verdict and what to do
about it (``advice``), and the ``doctor_page`` that says so. In come a calibration and what people say of it; out come
sentences.
"""
