# SPDX-License-Identifier: Apache-2.0
"""Runs many configurations of one scene, sharing every job that their settings leave alone, and records what each cost
and reached.

In comes a list of settings and their values; out come records, and a page of what accuracy costs. Steps, in the order
of the data: ``plan`` (a ``table`` of configurations), ``run`` (every row, with ``jobs`` as Snakemake remembers them,
its ``outcome`` and the machine's ``fingerprint`` in ``records``), ``page`` (``tradeoff``, on the arithmetic of
``pareto``). ``section`` is the piece that the report shows; ``runs_csv`` the table of all runs.
"""
