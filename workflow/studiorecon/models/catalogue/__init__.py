# SPDX-License-Identifier: Apache-2.0
"""What is known about networks without running one: cards in, decisions about weights, licences and images out.

In reading order: ``card`` (the nouns), ``registry`` (the list of adapters), ``selection`` (settings that name
networks, and what a configuration makes of them), ``checksums`` and ``fetching`` (files), ``pickles`` (of arrays,
read without running code), ``confined`` (what upstream may not do in a run), ``preflight`` (what is checked before a
network is loaded).
"""
