# SPDX-License-Identifier: Apache-2.0
"""The one exception of a step that cannot produce a correct result."""


class UserError(Exception):
    """One sentence for the user: what is wrong, where (file, camera, person, frame), and what would help.

    The command line prints it without a traceback and exits with status 1.
    """

    def __init__(self, sentence: str) -> None:
        super().__init__(printable(sentence))


def printable(text: str) -> str:
    """``text`` on one line: names of files may hold line ends, marks that turn the reading direction, or bytes of
    another encoding, which come as escapes. Tabs stay: rows of tables are copied from messages."""
    return "".join(c if c.isprintable() or c in "\u00a0\t" else ascii(c)[1:-1] for c in text)
