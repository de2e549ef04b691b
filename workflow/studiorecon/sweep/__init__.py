# SPDX-License-Identifier: Apache-2.0
"""Measures the cost of accuracy on one scene: runs a table of configurations and shows quality over time.

In: a ``table`` of settings. ``row`` runs one configuration as a Snakemake run of its own, which starts from a copy of
the base's, and writes its record. ``page`` draws all records: Pareto front, price list, effect of every parameter.
"""
