# SPDX-License-Identifier: Apache-2.0
"""``studiorecon open``, one local page from videos to the film, and the server that ``studiorecon view`` shares.

Read ``serving`` (the server, its gate and its files), ``app`` (what the page asks for), ``projects`` (captures and what
was made of them), ``runs`` (Snakemake as a process of its own), ``people`` (identities by clicks) and ``shots`` (paths
that were flown). The page is in resources/window.
"""
