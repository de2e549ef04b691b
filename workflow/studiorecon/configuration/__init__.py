# SPDX-License-Identifier: Apache-2.0
"""Settings, each declared once: a field of the dataclass that its step takes.

In: the ``Settings`` of the steps (``setting``: default, meaning, unit, bounds, the paper's value); out:
config/config.yaml, its schema and the tables of config/README.md (``generate``). In the order to read:

* ``setting``: one declaration; ``plan_settings``: settings that no step reads; ``sections``: their order;
* ``setting_schema`` and ``generate``: the files made of them; ``catalogue``: all settings with their meaning;
* ``paper_settings``: docs/paper.md, every setting that the paper mentions and whether the presets use its value.

When a run starts, ``overlays`` opens the files that a user lays over the defaults, ``schema`` checks the user's values,
``step_settings`` selects those that one step reads, and ``settings`` makes the step's dataclass from them.
"""
