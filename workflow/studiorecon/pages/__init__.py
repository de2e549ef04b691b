# SPDX-License-Identifier: Apache-2.0
"""Pages for people: one skeleton for the report, the doctor, the identities, a sweep and a run that is on.

What a page says goes in as plain text and comes out escaped, for it is put into templates (jinja2, with escaping on);
only what a template has made is taken as HTML. A page is one file that needs no network.

``skeleton``: the looks, the whole document, and how a template is filled. ``html``: blocks that several pages share,
each a piece of HTML. ``running``: the page of a run that is on. ``ending``: a run's last lines in the terminal. The
doctor's and the identities' templates stand with their steps, the report's sections in ``report.sections``.
"""
