# SPDX-License-Identifier: Apache-2.0
"""Settings, each declared once: a field of the dataclass that its step takes.

In come the ``Settings`` of the steps (``setting``: default, meaning, unit, bounds, the paper's value); out go
config/config.yaml, its schema and the tables of config/README.md (``written``). Read ``setting`` (one declaration),
``planned`` (what no step reads), ``sections`` (the order), ``schema_of``, ``written``, and ``letter``
(docs/paper.md: every setting of which the paper speaks, and whether its presets take the paper at its word).
"""
