# SPDX-License-Identifier: Apache-2.0
"""The sections of the page. In: results as arrays and tables; out: pieces of HTML.

``html`` (building blocks), ``pictures``, ``comparison_slider``, ``charts``; then the sections: ``quality_summary``,
``tables``, ``timeline``, ``verdicts``, ``paper``, ``cost``, ``licences``, ``appendix``.
"""
