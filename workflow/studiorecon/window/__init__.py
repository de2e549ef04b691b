# SPDX-License-Identifier: Apache-2.0
"""Pages for this machine's browser.

Read ``serving`` (the server, its gate and its files).
"""
