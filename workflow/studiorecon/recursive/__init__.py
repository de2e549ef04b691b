# SPDX-License-Identifier: Apache-2.0
"""The paper's recursive module: passes pictures in order through an enhancer, each blended with earlier outputs.

In reading order: ``flows`` (optical flow), ``alignment`` (earlier pictures warped to the current one), ``injection``
(their share in it), ``sequence`` (picture after picture). Enhancer and flow are any objects that satisfy
``models.protocols``. Films (``enhance``) and views of the half-trained room (``background.refined``) use it.
"""
