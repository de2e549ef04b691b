# SPDX-License-Identifier: Apache-2.0
"""3D Gaussian splatting: a rasteriser with exact gradients, and the training of Gaussians.

Inputs are ``scene.gaussians.Gaussians`` and cameras; outputs are pictures, gradients and trained Gaussians. In reading
order:

``conventions``  constants that both devices share
``rendering``    inputs and outputs of a rasteriser
``cpu``          the rasteriser in numba kernels, and the kernels of losses and Adam
``cuda``         gsplat behind the same calls, and sets in training as tensors
``device``       chooses between the two
``discs``, ``seeds``  flat Gaussians on surfaces: on given points, and a room's first ones on depth maps
``rigid_object``  a set of Gaussians that moves as one
``scene_files``  a trained scene, read from its files
``train``        the one training loop, its terms, optimiser and density control
``reference``    the slow float64 reference that tests compare with

numba compiles a kernel when it is first called and keeps the machine code in the user's cache (``kernel_cache``) or in
NUMBA_CACHE_DIR, so rendering alone never compiles the gradients.
"""
