# SPDX-License-Identifier: Apache-2.0
"""The sections of the page. In: results as arrays and tables; out: pieces of HTML.

Building blocks: ``pictures``, ``comparison_slider`` and ``pages.html``. Sections: ``quality_summary``, ``tables``,
``timeline``, ``verdicts``, ``paper``, ``cost``, ``licences``, ``appendix``.
"""
