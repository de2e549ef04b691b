# SPDX-License-Identifier: Apache-2.0
"""Blocks of pages: every function returns a complete piece of HTML.

Blocks are templates, so their arguments are escape; a block that takes HTML says so.
"""

from __future__ import annotations

import base64
import re
from collections.abc import Sequence
from typing import TYPE_CHECKING

import cv2
import numpy as np
from markupsafe import Markup
from markupsafe import escape as escape_markup

from studiorecon.pages.skeleton import fill_template, page

if TYPE_CHECKING:
    from jaxtyping import Integer

__all__ = ["bar", "contents", "details", "escape", "figure", "film", "heading", "jpeg", "page", "row", "table", "tiles"]

_HEADING = """<a id="{{ anchor }}"></a><h2>{{ title }}</h2>{% if lead %}<p class="soft">{{ lead }}</p>{% endif %}"""
_HEADINGS = re.compile(r'<a id="([^"]*)"></a><h2>(.*?)</h2>')
_CONTENTS = """<nav class="contents">{% for anchor, title in entries -%}
<a href="#{{ anchor }}">{{ title }}</a>{%- endfor %}</nav>"""
_TILES = """<div class="tiles">{% for value, words in entries -%}
<div class="tile"><b>{{ value }}</b><span>{{ words }}</span></div>{%- endfor %}</div>"""
_FIGURE = """<figure><img src="{{ address }}" alt="{{ caption }}"><figcaption>{{ caption }}</figcaption></figure>"""
_ROW = """<div class="row" style="grid-template-columns: repeat({{ columns }}, 1fr)">
{%- for figure in figures %}{{ figure }}{% endfor %}</div>"""
_FILM = """<figure><video controls loop muted autoplay playsinline><source type="video/mp4" src="{{ address }}"></video>
<figcaption>{{ caption }}</figcaption></figure>"""
_TABLE = """<div class="scroll"><table{% if wide %} class="wide"{% endif %}><thead><tr>
{%- for h in header %}<th{% if loop.index0 in numeric %} class=n{% endif %}>{{ h }}</th>{% endfor -%}
</tr></thead><tbody>
{%- for row in rows %}<tr>
{%- for v in row %}<td{% if loop.index0 in numeric %} class=n{% endif %}
{%- if wide %} data-of="{{ header[loop.index0] }}"{% endif %}>{{ v }}</td>{% endfor -%}
</tr>{% endfor %}</tbody></table></div>"""
_BAR = """<div class="bar"><i style="width:{{ percent }}%"></i></div>"""
_FOLDED = """<details><summary>{{ title }}</summary><pre>{{ content }}</pre></details>"""


def escape(value: object) -> str:
    """Escaped text."""
    return str(escape_markup(str(value)))


def heading(title: str, lead: str = "") -> str:
    """A section's heading and, below it, an explanation of the section."""
    return str(fill_template(_HEADING, title=title, lead=lead, anchor=re.sub(r"\W+", "-", title.lower()).strip("-")))


def contents(body: Sequence[str]) -> str:
    """Links to the headings of the pieces of a page."""
    found = [(anchor, Markup(title)) for part in body for anchor, title in _HEADINGS.findall(part)]
    return str(fill_template(_CONTENTS, entries=found))


def tiles(entries: Sequence[tuple[str, str]]) -> str:
    """Large numbers with a line of explanation each."""
    return str(fill_template(_TILES, entries=entries))


def jpeg(picture: Integer[np.ndarray, "H W 3"], width: int, quality: int = 86) -> str:
    """Data address of an (H, W, 3) uint8 picture, shrunk to ``width`` when it is wider."""
    if picture.shape[1] > width:
        size = (width, max(1, round(picture.shape[0] * width / picture.shape[1])))
        picture = cv2.resize(picture, size, interpolation=cv2.INTER_AREA)
    _, data = cv2.imencode(".jpg", np.ascontiguousarray(picture[..., ::-1]), [cv2.IMWRITE_JPEG_QUALITY, quality])
    return "data:image/jpeg;base64," + base64.b64encode(data.tobytes()).decode()


def figure(address: str, caption: str) -> str:
    """A picture given by its data address, with its caption, which is also its text alternative."""
    return str(fill_template(_FIGURE, address=address, caption=caption))


def row(figures: Sequence[str], columns: int | None = None) -> str:
    """Figures (HTML) in one row."""
    return str(fill_template(_ROW, figures=[Markup(f) for f in figures], columns=columns or max(len(figures), 1)))


def film(mp4: bytes, caption: str) -> str:
    """A film that plays in the page."""
    return str(fill_template(_FILM, address="data:video/mp4;base64," + base64.b64encode(mp4).decode(), caption=caption))


def table(
    header: Sequence[str], rows: Sequence[Sequence[str]], numeric: Sequence[int] = (), raw: Sequence[int] = ()
) -> str:
    """A table; columns in ``numeric`` are aligned right, cells of columns in ``raw`` are HTML already.

    On a phone the rows of a table with many columns become lists.
    """
    cells = [[Markup(v) if i in raw else str(v) for i, v in enumerate(r)] for r in rows]
    return str(fill_template(_TABLE, header=header, rows=cells, numeric=numeric, wide=len(header) > 5))


def bar(share: float) -> str:
    """A horizontal bar for a share of 0..1."""
    return str(fill_template(_BAR, percent=f"{100 * min(max(share, 0.0), 1.0):.1f}"))


def details(title: str, content: str) -> str:
    """Text that the reader can expand."""
    return str(fill_template(_FOLDED, title=title, content=content))
