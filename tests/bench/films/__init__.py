# SPDX-License-Identifier: Apache-2.0
"""Films: what a picture costs (``pictures``), what enhancement buys and costs (``enhancement``)."""
