# SPDX-License-Identifier: Apache-2.0
"""Trains Gaussians: a start, targets and weights of terms come in, trained Gaussians go out.

One loop runs every training. Its subject defines parameters, targets and hooks; its loss is a list of terms. In reading
order:

``targets``      images to fit, and their draw order
``schedule``     settings, and the rates that follow from them
``terms``        the list of terms, each for both devices; ``photometric``, ``perceptual`` hold the larger two
``optimiser``    Adam on arrays and on parameter blocks
``density``      when and where Gaussians are added, removed or moved
``trainer``      the loop, and ``Trainable``: the interface of its subject
``state``, ``blocked_set``  a still set in training on the CPU (on CUDA: ``cuda.tensor_set``)
``still``        trains a set that does not move, on either device; a person is ``humans.training``
``checkpoint``, ``previews``  resuming a killed run, and progress messages
"""
