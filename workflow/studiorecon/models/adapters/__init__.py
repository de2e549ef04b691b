# SPDX-License-Identifier: Apache-2.0
"""One module per upstream network (or per family that one class runs): the only places that know upstream's names.

Each holds ``CARDS`` (terms, weights, image, memory), ``preprocess`` and ``postprocess``, which carry our pictures,
cameras and units into upstream's conventions and back and are tested without it, and ``ADAPTER``, the class that
loads the network once and calls it. Upstream is imported inside functions alone: the modules run on Python 3.10
with old numpy, in images of their own.

In the order of the data: ``pi3``, ``mapanything`` (cameras and depth), ``moge`` (depth), ``sam3`` (people's masks),
``comotion`` (bodies), ``gen3c`` with ``gen3c_request`` (views), ``difix``, ``fixer`` (repaired pictures), ``raft``
(flow), ``lpips`` (distance), ``lhm`` (people in a rest pose).

Before and after a network stand numpy and OpenCV, which every image has, not kornia: its ``resize`` differs from PIL's
and torch's, on which networks were trained, by up to 0.31 of 1 (0.14 with antialias, making pictures half as large);
its ``normalize`` and morphological ``gradient`` give LPIPS' standardised pictures and Pi3's edges to the last bit, and
would be a further package in four images for one line each; its warps go backwards, GEN3C's cache goes forwards; and
it has no padding of its own. On the device that trains and films, it does the windows (``splatting``).

To add one: its module here, its line in ``catalogue.registry.MODULES``, its test in ``tests/models``, and an image
in ``envs`` where none has what it needs. Settings, schema and docs/networks.md follow from the card.
"""
