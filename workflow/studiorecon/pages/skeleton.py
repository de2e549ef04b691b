# SPDX-License-Identifier: Apache-2.0
"""The style that all pages share, the whole document, and filling of templates."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import Any

from jinja2 import Environment, StrictUndefined
from markupsafe import Markup

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
.contents { display: flex; flex-wrap: wrap; gap: 4px 18px; margin: 18px 0; font-size: 14px; }
.contents a, .open a { color: var(--mark); }
.lead { font-size: 18px; max-width: 70ch; }
.open { position: relative; display: block; } .open figure { margin: 8px 0 14px; }
.open b { position: absolute; left: 16px; top: 16px; background: var(--mark); color: #fff; border-radius: 8px;
  padding: 8px 14px; }
details { margin: 8px 0; } summary { cursor: pointer; }
@media (max-width: 640px) {
  main { padding: 20px 14px 60px; } h1 { font-size: 24px; }
  .row { grid-template-columns: repeat(2, 1fr) !important; }
  .tiles { grid-template-columns: 1fr 1fr; gap: 8px; margin: 14px 0; } .tile { padding: 8px 10px; }
  .tile b { font-size: 20px; } .bar { min-width: 40px; } .lead { font-size: 16px; }
  table { font-size: 12px; } th { font-size: 11px; } th, td { padding-right: 6px; } td { overflow-wrap: anywhere; }
  td.n, th.n { white-space: normal; overflow-wrap: break-word; }
  .wide, .wide tbody, .wide tr { display: block; } .wide thead { display: none; }
  .wide tr { border-bottom: 1px solid var(--line); padding: 6px 0; }
  .wide td { display: flex; justify-content: space-between; gap: 14px; border: 0; padding: 2px 0; }
  .wide td::before { content: attr(data-of); color: var(--soft); }
  pre { white-space: pre-wrap; overflow-wrap: anywhere; }
}
@media print { main { max-width: none; padding: 0; } figure, tr, svg { break-inside: avoid; } video { display: none; } }
pre { background: var(--wash); border: 1px solid var(--line); border-radius: 8px; padding: 12px; overflow-x: auto;
font-size: 13px; }
"""

_DOCUMENT = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">
{% if reload_s is not none %}<meta http-equiv="refresh" content="{{ reload_s }}{{ ';url=' ~ then if then }}">{% endif %}
<title>{{ title }}</title><style>{{ style }}</style></head>
<body><main>
{% for part in body %}
{{ part }}
{% endfor %}
</main></body></html>
"""


@cache
def _environment() -> Environment:
    return Environment(
        autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True, keep_trailing_newline=True
    )


@cache
def _compile(template: str) -> Any:
    return _environment().from_string(template)


def fill_template(template: str, **values: Any) -> Markup:
    """``template`` (jinja2) with ``values``, all of which are escaped except the output of templates.

    Raises UndefinedError for a value that the template names and that is missing.
    """
    return Markup(_compile(template).render(**values))


def page(title: str, body: Sequence[str], style: str = "", reload_s: int | None = None, then: str = "") -> str:
    """The whole document from pieces of HTML; ``style`` is added to the common style.

    With ``reload_s`` a browser reloads it after that many seconds, or goes on to ``then``.
    """
    pieces = [Markup(part) for part in body]
    return fill_template(_DOCUMENT, title=title, style=Markup(STYLE + style), body=pieces, reload_s=reload_s, then=then)
