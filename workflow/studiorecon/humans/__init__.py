# SPDX-License-Identifier: Apache-2.0
"""People as Gaussians in the body's rest pose: reads videos, masks and fitted bodies, writes ``<person>.{ply,npz}``.

``train`` is the step: ``rest_pose``, ``surface_samples`` and ``colours`` (first Gaussians), ``crops`` and
``crop_reader`` (training pictures), ``training`` (terms and hooks; on a GPU ``tensor_person``), ``refined_motion``
(poses refined on pictures), ``drift`` and ``appearance`` (colours that change over time), ``result_cache`` (reuses
earlier results). On request: ``canonical`` (a person by a network) from a ``photo`` of the capture or of a
``stranger``, ``proxy`` (the body itself). Settings: ``start_settings``, ``train_settings``, and the ``additions`` to
the paper.
"""
