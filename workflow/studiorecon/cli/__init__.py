# SPDX-License-Identifier: Apache-2.0
"""``studiorecon`` for people who type: its words, and what they see while it works.

Read ``command`` (the words, each a thin call of the packaged Snakefile), ``viewer`` (a finished scene in the browser)
and ``run_progress`` (how far a run is, for its line in the terminal and its page).
"""
