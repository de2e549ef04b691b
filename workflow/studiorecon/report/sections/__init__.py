# SPDX-License-Identifier: Apache-2.0
"""The page, section by section. In come results as they were read; out come pieces of HTML.

``html`` (building blocks), ``pictures``, ``comparison_slider``, ``charts``; then the sections: ``tables``,
``timeline``, ``verdicts``, ``paper``, ``solvers``, ``cost``, ``licences``, ``appendix``.
"""
