# SPDX-License-Identifier: Apache-2.0
"""Upstream networks: what each needs and may, and how it is run. None is used unless a setting names it.

A kind and a name go in (``load("flow", "raft", weights, device)``), an object that satisfies the kind's Protocol
comes out. To be read in this order:

- ``protocols``: one Protocol per kind, in this project's conventions; the nouns that they give back.
- ``adapters``: a module per network, with its class and its card.
- ``catalogue``: cards in general, the list of adapters, which settings select them, weights and what is checked
  before one is loaded.
- ``points``: cards of networks whose file runs as it is, behind the detector.
- ``loading``: ``load`` and ``adapter``, which is all that stages ask. ``choices``: types of the settings that name
  networks.
- Steps of their own: ``weights`` lists and fetches files, ``containers`` builds images, ``smpl`` makes arrays of
  SMPL's pickle.
"""
