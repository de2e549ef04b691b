# SPDX-License-Identifier: Apache-2.0
"""The command ``studiorecon``: its subcommands, and its progress display.

Read ``command`` (the subcommands), ``takes`` (many captures of one rig), ``real_demo`` (a published take to try),
``snakemake_call`` (the call of the packaged Snakefile, which each of them makes), ``quick_check`` (what a capture
holds, before any job) and ``run_progress`` (the progress of a run, for its line in the terminal, its page and the
window).
"""
