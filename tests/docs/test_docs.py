# SPDX-License-Identifier: Apache-2.0
"""The pages for people: they build strictly, their links lead somewhere, and what they tell to type exists."""

from __future__ import annotations

import ast
import importlib.util
import os
import re
import shlex
import subprocess
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import pytest
import yaml
from studiorecon.cli.command import main as command_main
from studiorecon.configuration.schema import mistakes

ROOT = Path(__file__).resolve().parents[2]
PAGES = [ROOT / "README.md", ROOT / "config/README.md", *sorted((ROOT / "docs").glob("*.md"))]
PROGRAMS = ("uv", "snakemake", "studiorecon", "python", "time", "pip")
# A word in capitals stands for something of the reader's own.
STAND_IN = re.compile(r"\b(DIR|FILE|SCENE|NAME|VIDEO|[A-Z]\.json|[A-Z]+\d?)\b")


def commands(text: str) -> Iterator[str]:
    """Every command line of a page: the lines of its fenced blocks and what stands between backticks."""
    fenced = re.findall(r"^```(?:bash|sh)?\n(.*?)^```", text, re.MULTILINE | re.DOTALL)
    inline = re.findall(r"`([^`\n]+)`", re.sub(r"^```.*?^```", "", text, flags=re.MULTILINE | re.DOTALL))
    for line in [line for block in fenced for line in block.split("\n")] + inline:
        for part in line.partition("  #")[0].split("&&"):
            if part.split()[:1] and part.split()[0] in PROGRAMS and len(part.split()) > 1:
                yield part.strip()


FOUND = sorted({(page.name, command) for page in PAGES for command in commands(page.read_text(encoding="utf-8"))})


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_lead_to_files(page: Path) -> None:
    for target in re.findall(r"\]\(([^)#\s]+)[^)]*\)", page.read_text(encoding="utf-8")):
        if not target.startswith("https://"):
            assert (page.parent / target).exists(), f"{page.name} links {target}, which is not there"


def test_pages_build_strictly(tmp_path: Path) -> None:
    site = [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "-f", "resources/site.yml"]
    reported = {**os.environ, "NO_MKDOCS_2_WARNING": "1"}
    built = subprocess.run(
        [*site, "-d", str(tmp_path / "site")], cwd=ROOT, capture_output=True, text=True, check=False, env=reported
    )
    assert built.returncode == 0, built.stdout + built.stderr
    assert "Time limit of one configuration of a sweep" in (tmp_path / "site/settings.html").read_text()


def test_every_page_is_in_the_table_of_contents() -> None:
    listed = re.findall(r"[\w-]+\.md", (ROOT / "resources/site.yml").read_text(encoding="utf-8"))
    assert sorted(listed) == sorted(page.name for page in PAGES if page.parent.name == "docs")


def rule_names() -> set[str]:
    texts = [ROOT / "Snakefile", *(ROOT / "workflow/rules").glob("*.smk")]
    return {
        name
        for text in texts
        for name in re.findall(r"^\s*(?:rule|checkpoint) (\w+):", text.read_text(encoding="utf-8"), re.MULTILINE)
    }


def read(path: str) -> Any:
    return yaml.safe_load((ROOT / path).read_text(encoding="utf-8"))


RULES, DEFAULTS, SCHEMA = rule_names(), read("config/config.yaml"), read("workflow/schemas/config.schema.yaml")


def laid_over(below: Any, above: Any) -> Any:
    if not (isinstance(below, Mapping) and isinstance(above, Mapping)):
        return above
    return {**below, **{key: laid_over(below.get(key), value) for key, value in above.items()}}


def check_snakemake(words: list[str]) -> None:
    values = {"--cores", "--profile", "--configfile", "--sdm", "--apptainer-args"}
    configuration = False
    waiting = ""
    for word in words:
        if waiting:
            if waiting in ("--configfile", "--profile") and not STAND_IN.search(word) and "/" in word:
                assert (ROOT / word).exists(), f"{word} is not there"
            waiting = ""
        elif word.startswith("-"):
            configuration = word in ("--config", "-C")
            waiting = word if word in values else ""
        elif configuration:
            key, _, value = word.partition("=")
            given = value if STAND_IN.fullmatch(value) else yaml.safe_load(value)
            assert not mistakes(laid_over(DEFAULTS, {key: given}), SCHEMA)
        elif not word.startswith("results/"):
            assert word in RULES, f"{word} is no target"


@pytest.mark.parametrize(("page", "command"), FOUND, ids=[f"{page}: {command[:60]}" for page, command in FOUND])
def test_commands_of_the_pages_exist(page: str, command: str, capsys: pytest.CaptureFixture[str]) -> None:
    words = [word for word in shlex.split(command) if word not in ("[", "]", "…")]
    words = words[1:] if words[0] == "time" else words
    if words[:2] == ["uv", "run"]:
        words = words[2:]
        while words[:1] and words[0].startswith("--"):
            words = words[2:]
    program, *rest = words or [""]
    if program == "snakemake":
        check_snakemake(rest)
    elif program == "studiorecon" and rest:
        with pytest.raises(SystemExit) as left:
            command_main([rest[0], "--help"])
        assert left.value.code == 0, f"studiorecon has no word {rest[0]}"
        reported = capsys.readouterr().out
        for word in (word for word in rest[1:] if word.startswith("--")):
            assert word in reported, f"studiorecon {rest[0]} has no {word}"
    elif program == "python":
        assert rest[0] == "-m", command
        name = f"studiorecon.{rest[1]}" if rest[1] == "studiorecon" and "." in rest[1] else rest[1]
        if name == "studiorecon":
            name = f"studiorecon.{rest[1 + 1]}"
        found = importlib.util.find_spec(name)
        assert found is not None, f"{name} is no module"
        if name == rest[1] and name.startswith(("studiorecon.", "tests.")):
            own = Path(found.origin or "")
            runs = (own.parent / "__main__.py").is_file() if found.submodule_search_locations else False
            assert runs or "__main__" in own.read_text(encoding="utf-8"), f"python -m {name} does nothing"
        options = [word.lstrip("[") for word in rest if word.lstrip("[").startswith("--")]
        if name.startswith("studiorecon.") and rest[1] == "studiorecon" and options:
            source = ast.parse(Path(found.origin or "").read_text(encoding="utf-8"))
            run = next(node for node in source.body if isinstance(node, ast.FunctionDef) and node.name == "run")
            known = {f"--{argument.arg}".replace("_", "-") for argument in [*run.args.args, *run.args.kwonlyargs]}
            assert set(options) <= known | {"--settings"}, f"{name} knows {sorted(known)}"


@pytest.mark.parametrize("form", sorted((ROOT / ".github").rglob("*.yml")), ids=lambda path: path.stem)
def test_forms_and_workflows_can_be_read(form: Path) -> None:
    assert set(yaml.safe_load(form.read_text(encoding="utf-8"))) >= {"name"}
