# SPDX-License-Identifier: Apache-2.0
"""The page, section by section. In come results as they were read; out come pieces of HTML.

``html`` (building blocks), ``pictures``, ``comparison_slider``, ``charts``; then the sections: ``judgement``,
``tables``, ``timeline``, ``verdicts``, ``paper``, ``cost``, ``licences``, ``appendix``.
"""
