# SPDX-License-Identifier: Apache-2.0
"""A person as Gaussians in the body's rest pose. In come canonical Gaussians and a motion; out come posed Gaussians.

``weight_grid`` and ``binding`` tie Gaussians to the body, ``posing`` moves them and brings gradients back,
``temporal`` (told where and when by ``encoding``, asked at ``control_points``) changes their looks over time, ``drift``
reads it at the moments of a film, ``avatar_files`` keeps all of it.
"""
