# SPDX-License-Identifier: Apache-2.0
"""The paper's recursive module: pictures in order through an enhancer, each seen together with those before it.

In reading order: ``flows`` (what finds where things moved), ``alignment`` (where earlier pictures lie on the current
one), ``injection`` (how much of them enters it), ``clip`` (picture after picture). The enhancer and the flow are
whatever satisfies ``models.protocols``. Films go through it (``enhance``), and views of the half-trained room
(``background.refined``).
"""
