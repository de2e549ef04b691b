# SPDX-License-Identifier: Apache-2.0
"""One module per upstream network (or per family that one class runs): the only places with upstream's names.

Each has ``CARDS`` (terms, weights, image, memory) and ``ADAPTER``, the class that loads the network once and calls it.
``preprocess`` and ``postprocess`` convert our pictures, cameras and units to upstream's conventions and back, and are
tested without it. Upstream is imported inside functions only: the modules run on Python 3.10 with old numpy, in images
of their own.

In the order of the data: ``pi3`` (cameras and depth), ``moge``, ``onnx_depth`` (depth), ``sam3``
(people's masks), ``comotion`` (bodies), ``gen3c`` with ``gen3c_request`` (views), ``difix``, ``fixer`` (repaired
pictures), ``raft`` (flow), ``lpips`` (distance), ``lhm`` (people in a rest pose).

Pre- and postprocessing use numpy and OpenCV, which every image has, and not kornia. Its ``resize`` differs from PIL's
and torch's, on which networks were trained, by up to 0.31 of 1 (0.14 with antialias, at half size). Its ``normalize``
and morphological ``gradient`` give LPIPS' standardised pictures and Pi3's edges to the last bit, but would add a
package to four images for one line each. Its warps are backward, GEN3C's cache is forward; and it has no padding of its
own. On the device that trains and films it does the windows (``splatting``).

To add one: its module here, its line in ``catalogue.registry.MODULES``, its test in ``tests/models``, and an image in
``envs`` unless an existing one meets its requirements. Settings, schema and docs/networks.md are generated from the
card.
"""
