# SPDX-License-Identifier: Apache-2.0
"""Writes config.yaml, its schema and the tables of config/README.md from the settings' declarations.

``python -m studiorecon.configuration.generate`` writes all three; a test compares them with the files.
"""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import yaml

from studiorecon.configuration.sections import SECTIONS, general_settings
from studiorecon.configuration.setting import Setting, literal_choices, plain_value
from studiorecon.configuration.setting_schema import section_schema
from studiorecon.home import CONFIGURATION, SCHEMA

README: Path = CONFIGURATION.parent / "README.md"
_COLUMNS = 120
_HEAD = """\
# Every setting, once, with its default: a first run on the synthetic studio takes minutes on two CPU cores.
# Written by python -m studiorecon.configuration.generate from the steps' Settings: change it there, not here.
# Comments give the paper's value and its section; U-numbers are readings of ambiguous passages.
# Overlays in config/presets/ only set what they change: snakemake --configfile config/presets/standard.yaml
# config/README.md says what each setting buys and costs.
"""
# Choices in a table's cell: more would make its row unreadable; ``studiorecon settings`` prints all.
_MAX_CHOICES, _SHOWN_CHOICES = 8, 3
# Innermost mappings and lists on one line.
_COMPACT: Mapping[str, Any] = {"default_flow_style": None}
_SCHEMA_HEAD = "# Written by python -m studiorecon.configuration.generate from the steps' Settings.\n"


def configuration_text() -> str:
    """The text of config.yaml."""
    parts = [_HEAD, "\n".join(_lines(general_settings(), 0)) + "\n"]
    for section in SECTIONS:
        head = [f"# ---- {section.name} ----", *_comment(section.about, 0), f"{section.name}:"]
        parts.append("\n".join([*head, *_lines(section.settings(), 2)]) + "\n")
    return "\n".join(parts)


def schema_text(there: str) -> str:
    """The text of the schema; the shapes of films (``$defs``) are taken from ``there``, its present text."""
    top = section_schema(general_settings(), "Settings of studiorecon; config/README.md explains them in prose.")
    for section in SECTIONS:
        top["required"].append(section.name)
        top["properties"][section.name] = section_schema(section.settings(), section.about)
    shapes = yaml.safe_load(there)["$defs"]
    made = {"$schema": "https://json-schema.org/draft/2020-12/schema", **top, "$defs": shapes}
    return _SCHEMA_HEAD + yaml.dump(
        made, Dumper=_Plain, sort_keys=False, allow_unicode=True, width=_COLUMNS, **_COMPACT
    )


def readme_text(there: str) -> str:
    """The text of config/README.md with tables generated from the declarations."""
    for name, settings in [("general", general_settings()), *((s.name, s.settings()) for s in SECTIONS)]:
        before, start, rest = there.partition(f"<!-- settings: {name} -->\n")
        after = "".join(rest.partition(f"<!-- end: {name} -->")[1:])
        there = before + start + "".join(f"{line}\n" for line in _table(settings)) + after
    return there


# Each file, and the function that makes its new text from its present one.
FILES: Mapping[Path, Callable[[str], str]] = {
    CONFIGURATION: lambda _: configuration_text(),
    SCHEMA: schema_text,
    README: readme_text,
}


class _Plain(yaml.SafeDumper):
    """A YAML dumper that repeats equal parts instead of using references."""

    def ignore_aliases(self, data: Any) -> bool:
        """Always true: the schema is for people to read."""
        return True


def _lines(settings: Iterable[Setting], indent: int) -> Iterator[str]:
    for setting in settings:
        yield from _comment(_description(setting), indent)
        key = f"{'':{indent}}{setting.name}:"
        if setting.is_section:
            yield key
            yield from _lines(setting.inner(), indent + 2)
        elif isinstance(setting.default, Mapping) and setting.default:
            yield key
            block = yaml.safe_dump(plain_value(setting.default), sort_keys=False, allow_unicode=True, width=_COLUMNS)
            yield from textwrap.indent(block, " " * (indent + 2)).splitlines()
        else:
            yield f"{key} {value_text(setting.default)}"


def _description(setting: Setting) -> str:
    """Meaning, choices, unit and the paper's value in one line of words."""
    info = setting.description
    choices = f" One of {', '.join(literal_choices(setting))}." if literal_choices(setting) else ""
    notes = "; ".join(filter(None, [info.unit, f"paper: {info.paper}" if info.paper else ""]))
    return f"{info.meaning}{choices}{f' ({notes})' if notes else ''}"


def _comment(words: str, indent: int) -> list[str]:
    mark = f"{'':{indent}}# "
    return textwrap.wrap(
        words, _COLUMNS, initial_indent=mark, subsequent_indent=mark, break_long_words=False, break_on_hyphens=False
    )


def value_text(value: Any) -> str:
    """A default as YAML text."""
    if value == "":
        return '""'
    text = yaml.safe_dump(plain_value(value), default_flow_style=True, allow_unicode=True, width=1000)
    return text.removesuffix("\n").removesuffix("\n...")


def _table(settings: Iterable[Setting], above: str = "") -> Iterator[str]:
    if not above:
        yield "| setting | default | may be | meaning |"
        yield "|---|---|---|---|"
    for setting in settings:
        name = f"{above}{setting.name}"
        if setting.is_section:
            yield from _table(setting.inner(), f"{name}.")
            continue
        default = (
            "see below" if isinstance(setting.default, Mapping) and setting.default else value_text(setting.default)
        )
        cells = [f"`{name}`", f"`{default}`", allowed_values(setting), setting.description.meaning]
        yield "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"


def allowed_values(setting: Setting) -> str:
    """The allowed values of a setting, in short: its words, or its bounds and unit."""
    info = setting.description
    if choices := literal_choices(setting):
        more = f", … ({len(choices)} in all)" if len(choices) > _MAX_CHOICES else ""
        return ", ".join(f"`{choice}`" for choice in choices[: _SHOWN_CHOICES if more else None]) + more
    low = f"≥ {info.minimum:g}" if info.minimum is not None else f"> {info.above:g}" if info.above is not None else ""
    high = f"≤ {info.maximum:g}" if info.maximum is not None else f"< {info.below:g}" if info.below is not None else ""
    bounds = ", ".join(filter(None, [low, high, "odd" if info.odd else ""]))
    return " ".join(filter(None, [bounds, info.unit]))


def main() -> None:
    """Write all three files."""
    for path, text_of in FILES.items():
        path.write_text(text_of(path.read_text(encoding="utf-8")), encoding="utf-8")


if __name__ == "__main__":
    main()
