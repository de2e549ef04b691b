# SPDX-License-Identifier: Apache-2.0
"""The plan of a run: everything that configuration and dataset decide before the first job.

In: the configuration and the workflow's folder. Out: a frozen ``Plan``, and the paths that rules ask for. Rules are
data; they read both as ``PLAN`` and ``files`` (``workflow/rules/common.smk``). In the order to read:

* ``dataset``: the user's dataset, or the synthetic studio that is filmed first. ``discovery`` reads the user's folder
  with ``films`` (chapters of recordings), ``pairing`` (camera names), ``keypoint_files`` and ``inventory`` (unused
  files);
* ``person_sources``: the cameras in which people are detected, and the method;
* ``networks``: the selected upstream networks, their images and GPUs;
* ``decisions``: the ``Plan`` itself; ``plan_checks``, ``dates``: inputs that cannot be run; ``make``: the whole plan;
* ``budget``: the preset that fits into ``budget_min``, from ``workload`` (the work of every rule) and ``prices``;
* ``memory``: what jobs ask for where it depends on sizes;
* ``command``: the shell line of a rule, from the signature of its step;
* ``step_config``: the settings that a step gets, including the decisions of ``survey.force``;
* ``user_inputs``, ``rule_files``: input files of rules that depend on the plan, the people or the survey;
  ``stale_lock``: removes the lock of a run that was killed.

Snakemake reads the plan at every start, so it decodes no pictures and compiles nothing.
"""
