# SPDX-License-Identifier: Apache-2.0
"""One maximum-a-posteriori estimate of cameras: unknowns, a list of factors, and one solver.

``unknowns``   poses and lenses of cameras, points, and whatever else a factor needs (bones, a floor)
``factor``     what a factor is: residuals in standard deviations, and how heavy their tails are
``factors``    the factors, a file each
``solver``     damped Gauss-Newton on the sparse normal equations
``intervals``  what the estimate's information matrix says about rotations, places and lenses
"""
