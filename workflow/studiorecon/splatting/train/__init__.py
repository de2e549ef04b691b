# SPDX-License-Identifier: Apache-2.0
"""Training of Gaussians: a start, targets and weights of terms come in, trained Gaussians go out.

One loop runs everything. What it trains describes itself (parameters, targets, hooks), and what it lowers is a list of
terms. In reading order:

``targets``      images to fit, the order they are drawn in
``schedule``     settings, and the rates that follow from them
``terms``        the list of terms, each for both devices; ``photometric``, ``perceptual`` hold the larger two
``optimiser``    Adam on arrays and on parameter blocks
``density``      when and where Gaussians are added, removed or moved
``trainer``      the loop, and ``Trainable``: what it asks of what it trains
``state``, ``blocked_set``  a still set in training on the CPU (on CUDA: ``cuda.tensor_set``)
``still``        the call: a set that stays where it is, on either device; a person is ``humans.training``
``checkpoint``, ``previews``  what a killed run goes on from, and how a run tells of itself
"""
