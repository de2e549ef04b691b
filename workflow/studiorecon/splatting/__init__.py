# SPDX-License-Identifier: Apache-2.0
"""3D Gaussian splatting on a CPU: a rasteriser with exact gradients, its losses, and a training loop.

Reading order: ``conventions`` (constants) · ``simd``, ``simd_rows`` (sixteen lanes inside numba) · ``harmonics`` · ``blocks`` ·
``projection`` · ``tiles`` · ``forward`` · ``backward`` · ``projection_gradient`` · ``rasterise`` (what other packages call) ·
``losses`` · ``adam`` · ``training``. ``reference`` is the slow float64 truth that tests compare with.

numba compiles a kernel when it is first called and keeps the machine code beside the source (or in NUMBA_CACHE_DIR when the
package folder cannot be written), so who only renders never compiles the gradients.
"""
