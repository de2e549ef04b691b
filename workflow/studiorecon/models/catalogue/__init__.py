# SPDX-License-Identifier: Apache-2.0
"""Facts about networks that need no network to run: cards in, decisions about weights, licences and images out.

In reading order: ``card`` (the types), ``registry`` (the list of adapters), ``selection`` (settings that select
networks), ``checksums`` and ``fetching`` (files), ``pickles`` (arrays read without running code), ``sandbox`` (limits
on upstream in a run), ``preflight`` (checks before a network is loaded).
"""
