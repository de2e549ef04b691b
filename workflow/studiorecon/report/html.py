# SPDX-License-Identifier: Apache-2.0
"""The page's looks and its building blocks: every function returns a piece of HTML with everything it shows inside it."""

from __future__ import annotations

import base64
import html
from collections.abc import Sequence

import cv2
import numpy as np

STYLE = """
:root { --ink: #1c2430; --soft: #5b6675; --line: #dfe4ea; --paper: #ffffff; --wash: #f5f7f9;
  --mark: #1f6feb; --good: #1a7f5a; --warn: #a15c00; }
@media (prefers-color-scheme: dark) {
  :root { --ink: #e6eaf0; --soft: #9aa6b5; --line: #2c343f; --paper: #14181e; --wash: #1b2129;
    --mark: #6ea8fe; --good: #58c99b; --warn: #e0a458; }
}
* { box-sizing: border-box; }
body { margin: 0; background: var(--paper); color: var(--ink);
  font: 16px/1.55 system-ui, "Segoe UI", Roboto, Helvetica, Arial, sans-serif; }
main { max-width: 1080px; margin: 0 auto; padding: 40px 24px 80px; }
h1 { font-size: 30px; line-height: 1.2; margin: 0 0 6px; }
h2 { font-size: 20px; margin: 52px 0 4px; padding-top: 14px; border-top: 1px solid var(--line); }
h3 { font-size: 16px; margin: 30px 0 4px; }
p { margin: 6px 0 14px; max-width: 76ch; }
.soft, figcaption, td.why { color: var(--soft); font-size: 14px; }
.tiles { display: grid; grid-template-columns: repeat(auto-fit, minmax(190px, 1fr)); gap: 12px; margin: 22px 0; }
.tile { background: var(--wash); border: 1px solid var(--line); border-radius: 10px; padding: 14px 16px; }
.tile b { display: block; font-size: 26px; line-height: 1.25; font-variant-numeric: tabular-nums; }
.tile span { color: var(--soft); font-size: 13px; }
video, img { display: block; width: 100%; height: auto; border-radius: 8px; background: #000; }
figure { margin: 12px 0; }
.row { display: grid; gap: 10px; }
.row figure { margin: 0; }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; width: 100%; font-size: 15px; margin: 8px 0 14px; }
th, td { text-align: left; padding: 6px 12px 6px 0; border-bottom: 1px solid var(--line); vertical-align: top; }
th { font-weight: 600; color: var(--soft); font-size: 13px; }
td.n, th.n { text-align: right; font-variant-numeric: tabular-nums; white-space: nowrap; }
.bar { background: var(--wash); border-radius: 4px; min-width: 160px; height: 12px; margin-top: 7px; }
.bar i { display: block; height: 12px; border-radius: 4px; background: var(--mark); min-width: 2px; }
.on { color: var(--good); font-weight: 600; } .undetermined { color: var(--warn); font-weight: 600; }
details { margin: 8px 0; } summary { cursor: pointer; }
@media (max-width: 640px) {
  main { padding: 20px 14px 60px; } h1 { font-size: 24px; }
  .row { grid-template-columns: repeat(2, 1fr) !important; }
}
@media print { main { max-width: none; padding: 0; } figure, tr, svg { break-inside: avoid; } video { display: none; } }
pre { background: var(--wash); border: 1px solid var(--line); border-radius: 8px; padding: 12px; overflow-x: auto; font-size: 13px; }
"""


def page(title: str, body: Sequence[str], style: str = "") -> str:
    """The whole document; ``style`` is added to what every page has."""
    viewport = '<meta name="viewport" content="width=device-width, initial-scale=1">'
    head = f'<head><meta charset="utf-8">{viewport}<title>{text(title)}</title><style>{STYLE}{style}</style></head>'
    return f'<!doctype html>\n<html lang="en">{head}\n<body><main>\n' + "\n".join(body) + "\n</main></body></html>\n"


def text(value: object) -> str:
    """Escaped text."""
    return html.escape(str(value))


def heading(title: str, lead: str = "") -> str:
    """A section's heading and, below it, what the reader is looking at."""
    return f"<h2>{text(title)}</h2>" + (f'<p class="soft">{text(lead)}</p>' if lead else "")


def tiles(entries: Sequence[tuple[str, str]]) -> str:
    """Large numbers with a line of explanation each."""
    return '<div class="tiles">' + "".join(f'<div class="tile"><b>{text(v)}</b><span>{text(t)}</span></div>' for v, t in entries) + "</div>"


def jpeg(picture: np.ndarray, width: int, quality: int = 86) -> str:
    """Data address of an (H, W, 3) uint8 picture, shrunk to ``width`` when it is wider."""
    if picture.shape[1] > width:
        size = (width, max(1, round(picture.shape[0] * width / picture.shape[1])))
        picture = cv2.resize(picture, size, interpolation=cv2.INTER_AREA)
    _, data = cv2.imencode(".jpg", np.ascontiguousarray(picture[..., ::-1]), [cv2.IMWRITE_JPEG_QUALITY, quality])
    return "data:image/jpeg;base64," + base64.b64encode(data.tobytes()).decode()


def figure(address: str, caption: str) -> str:
    """A picture given by its data address, with its caption, which is also its text alternative."""
    return f'<figure><img src="{address}" alt="{text(caption)}"><figcaption>{text(caption)}</figcaption></figure>'


def row(figures: Sequence[str], columns: int | None = None) -> str:
    """Figures side by side."""
    return f'<div class="row" style="grid-template-columns: repeat({columns or max(len(figures), 1)}, 1fr)">' + "".join(figures) + "</div>"


def film(mp4: bytes, caption: str) -> str:
    """A film that plays in the page."""
    data = base64.b64encode(mp4).decode()
    source = f'<source type="video/mp4" src="data:video/mp4;base64,{data}">'
    return f"<figure><video controls loop muted autoplay playsinline>{source}</video><figcaption>{text(caption)}</figcaption></figure>"


def table(header: Sequence[str], rows: Sequence[Sequence[str]], numeric: Sequence[int] = (), raw: Sequence[int] = ()) -> str:
    """A table; columns in ``numeric`` are aligned right, cells of columns in ``raw`` are HTML already."""

    def cell(tag: str, index: int, value: str) -> str:
        content = value if tag == "td" and index in raw else text(value)
        return f"<{tag}{' class=n' if index in numeric else ''}>{content}</{tag}>"

    head = "".join(cell("th", i, h) for i, h in enumerate(header))
    body = "".join("<tr>" + "".join(cell("td", i, v) for i, v in enumerate(r)) + "</tr>" for r in rows)
    return f'<div class="scroll"><table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>'


def bar(share: float) -> str:
    """A horizontal bar for a share of 0..1."""
    return f'<div class="bar"><i style="width:{100 * min(max(share, 0.0), 1.0):.1f}%"></i></div>'


def folded(title: str, content: str) -> str:
    """Text that opens on demand."""
    return f"<details><summary>{text(title)}</summary><pre>{text(content)}</pre></details>"
