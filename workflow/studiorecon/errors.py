# SPDX-License-Identifier: Apache-2.0
"""The one exception of a step that cannot produce a correct result."""


class UserError(Exception):
    """One sentence for the user: what is wrong, where (file, camera, person, frame), and what would help.

    The command line prints it without a traceback and exits with status 1.
    """
