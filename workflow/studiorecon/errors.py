# SPDX-License-Identifier: Apache-2.0
"""The one exception a step raises when it cannot do honest work."""


class UserError(Exception):
    """One sentence for the user: what is wrong, where (file, camera, person, frame), and what would help.

    The command line prints it without a traceback and exits with status 1.
    """
