# SPDX-License-Identifier: Apache-2.0
"""The plan of a run: what is decided from the configuration and the dataset before anything runs.

In: the configuration and the workflow's folder. Out: a frozen ``Plan``, and the paths that rules ask for. Rules are
data; they read both as ``PLAN`` and ``files`` (``workflow/rules/common.smk``). In the order to read:

* ``dataset``: the user's dataset (found by ``discovery``: ``films`` and their chapters,
  names by ``pairing``, ``keypoint_files``, and what is not used by ``inventory``), or the synthetic studio that is
  filmed first;
* ``sight``: in whose pictures people are looked for, and by what;
* ``networks``: the upstream networks that are asked for, their images and GPUs;
* ``decisions``: the ``Plan`` that these make up; ``refusals``, ``dates``: what cannot be run; ``make``: all of
  it together;
* ``budget``: the preset that ``budget_min`` buys, by ``workload`` (what is asked of every rule) and ``prices``;
* ``command``: the shell line of a rule, from the signature of its step;
* ``told``: which settings a step is told, with what ``survey.force`` decides;
* ``brought``, ``rule_files``: the files that rules take where these hang on the plan, on who was found or on the
  survey; ``left_lock``: whether a run that was killed left its lock.

Decodes no pictures and compiles nothing: Snakemake reads it at every start.
"""
