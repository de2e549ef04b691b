# SPDX-License-Identifier: Apache-2.0
"""Upstream networks: requirements, licences, and the code that runs them. None is used unless a setting names it.

``load("flow", "raft", weights, device)`` takes a kind and a name, and returns an object that satisfies the kind's
Protocol. To be read in this order:

- ``protocols``: one Protocol per kind, in this project's conventions, and the types that they return.
- ``adapters``: a module per network, with its class and its card.
- ``catalogue``: cards in general, the list of adapters, the settings that select them, weights and checks before
  loading.
- ``points``: cards of networks that run directly from their file, after the detector.
- ``loading``: ``load`` and ``adapter``, the only functions that stages call. ``choices``: types of the settings that
  name networks.
- Steps of their own: ``weights`` lists and fetches files, ``containers`` builds images, ``smpl`` converts SMPL's pickle
  to arrays.
"""
