# SPDX-License-Identifier: Apache-2.0
"""Runs many configurations of one scene, sharing every job that their settings leave alone, and records what each cost and reached."""
