# SPDX-License-Identifier: Apache-2.0
"""Settings, each declared once: a field of the dataclass that its step takes.

In come the ``Settings`` of the steps (``setting``: default, meaning, unit, bounds, the paper's value); out go
config/config.yaml, its schema and the tables of config/README.md (``written``). Read ``setting`` (one declaration),
``planned`` (what no step reads), ``sections`` (the order), ``schema_of``, ``written``, ``catalogue`` (all of them with
their meaning, for people), and ``paper_settings`` (docs/paper.md: every setting of which the paper speaks, and whether
its presets take the paper at its word).

On the way back, ``overlays`` opens the files that a user lays over the defaults, ``schema`` checks what a user wrote,
``step_settings`` takes of it what one step reads, and ``settings`` makes the step's dataclass of that.
"""
