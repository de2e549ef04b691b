# SPDX-License-Identifier: Apache-2.0
"""Where cameras should stand: what a rig will see of a room and its people, and how well, before anything is filmed."""
