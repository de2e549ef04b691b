# SPDX-License-Identifier: Apache-2.0
"""The command ``studiorecon``: its subcommands, and its progress display.

Read ``command`` (the subcommands, each a thin call of the packaged Snakefile), ``takes`` (many captures of one rig) and
``run_progress`` (the progress of a run, for its line in the terminal and its page).
"""
