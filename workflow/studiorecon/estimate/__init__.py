# SPDX-License-Identifier: Apache-2.0
"""One maximum-a-posteriori estimate of cameras: unknowns, a list of factors, and one solver.

``unknowns``   poses and lenses of cameras, points, and whatever else a factor needs (bones, a floor)
``factor``     a factor: residuals in standard deviations, and the tails of their distribution
``factors``    the factors, a file each
``solver``     damped Gauss-Newton; small blocks of unknowns are eliminated
``intervals``  uncertainty of rotations, positions and lenses from the information matrix
"""
