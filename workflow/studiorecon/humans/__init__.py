# SPDX-License-Identifier: Apache-2.0
"""People as Gaussians in the body's rest pose. In come videos, masks and bodies; out come ``<person>.{ply,npz}``.

``train`` is the step: ``rest_pose``, ``surface_samples`` and ``colours`` (first Gaussians), ``crops`` and ``filmed``
(training pictures), ``training`` (terms and hooks), ``refined_motion`` (poses moved by pictures), ``drift`` and
``appearance`` (looks that change over time), ``result_cache`` (what need not be trained again). On request:
``canonical`` (a person by a network) from a ``photo`` of the capture or of a ``stranger``, ``proxy`` (the body itself).
Settings: ``start_settings``, ``train_settings``, and the ``additions`` to the paper.
"""
