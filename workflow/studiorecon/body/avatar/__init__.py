# SPDX-License-Identifier: Apache-2.0
"""One person as Gaussians in the body's rest pose; with a motion they become posed Gaussians.

``weight_grid`` and ``binding`` tie Gaussians to the body. ``posing`` moves them and returns gradients, on a GPU
``tensor_posing``. ``temporal`` changes their colour and opacity over time: ``encoding`` encodes position and time,
``control_points`` are where the network is evaluated, ``drift`` evaluates it at the times of a film. ``avatar_files``
reads and writes all of it. ``kernels`` has their loops.
"""
