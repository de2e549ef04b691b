# SPDX-License-Identifier: Apache-2.0
"""HTML pages for people: one skeleton for the report, the doctor, the identities, a sweep and a live run.

Text is escaped when it is put into templates (jinja2, with escaping on); only the output of a template counts as HTML.
A page is one file that needs no network.

``skeleton``: the style, the whole document, and filling of templates. ``html``: blocks that several pages share, each a
piece of HTML. ``run_page``: the page of a live run. ``run_summary``: a run's last lines in the terminal. The doctor's
and the identities' templates are next to their steps, the report's sections in ``report.sections``.
"""
