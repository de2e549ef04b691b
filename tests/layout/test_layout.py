# SPDX-License-Identifier: Apache-2.0
"""The house keeps its shape: who imports whom, what every stage has, and how files look."""

from __future__ import annotations

import ast
import importlib
import inspect
import re
import subprocess
from functools import cache
from pathlib import Path

import pytest
import yaml
from studiorecon import code
from studiorecon import settings as settings_module

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = ROOT / "workflow" / "studiorecon"
STAGES = ["capture", "cameras", "people", "masks", "depth", "survey", "views", "background", "humans", "render"]
STAGES += ["enhance", "report", "deliver"]
FOUNDATIONS = ["scene", "geometry", "images", "body", "splatting"]
CARD = {"Snakefile", "workflow", "envs", "config", "resources", "tests", "README.md"}
DEMANDED_BY_TOOLS = {"pyproject.toml", "LICENSE", "profiles", ".ci", ".gitignore"}
MODULES = sorted(p for p in PACKAGE.rglob("*.py"))


def tracked() -> list[str]:
    listing = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=False)
    return listing.stdout.split("\n")[:-1] if listing.returncode == 0 else []


def name_of(path: Path) -> str:
    return ".".join(path.relative_to(PACKAGE).with_suffix("").parts).removesuffix(".__init__")


@pytest.mark.parametrize("path", MODULES, ids=name_of)
def test_imports_go_one_way(path: Path) -> None:
    room = path.relative_to(PACKAGE).parts[0]
    for module in code.imported_by(path):
        other = module.split(".")[0]
        if room in FOUNDATIONS:
            assert other not in [*STAGES, "studio", "models"], f"{name_of(path)} is a foundation and imports {module}"
        if room in STAGES or room == "studio":
            assert other == room or other not in [*STAGES, "studio"], f"{name_of(path)} imports another stage: {module}"


@pytest.mark.parametrize("path", MODULES, ids=name_of)
def test_file_is_short_and_licensed(path: Path) -> None:
    lines = path.read_text().splitlines()
    assert lines[0] == "# SPDX-License-Identifier: Apache-2.0"
    assert len(lines) <= 300, "past 300 lines it is two ideas"
    assert not re.search(r"(^|_)(utils?|helpers?|misc|manager|common)$", path.stem)


@pytest.mark.parametrize("path", [p for p in MODULES if p.parent.name == "models"], ids=name_of)
def test_adapters_import_upstream_names_only_inside_functions(path: Path) -> None:
    allowed = {"__future__", "numpy", "dataclasses", "typing", "pathlib", "collections", "json", "math", "os", "importlib", "studiorecon"}
    for node in ast.parse(path.read_text()).body:
        names = [a.name for a in node.names] if isinstance(node, ast.Import) else [node.module] if isinstance(node, ast.ImportFrom) else []
        assert {str(n).split(".")[0] for n in names} <= allowed


@pytest.mark.parametrize("stage", STAGES)
def test_every_stage_has_rules_settings_schema_and_tests(stage: str) -> None:
    assert (ROOT / f"workflow/rules/{stage}.smk").is_file()
    assert f'include: "workflow/rules/{stage}.smk"' in (ROOT / "Snakefile").read_text()
    assert stage in yaml.safe_load((ROOT / "config/config.yaml").read_text())
    schema = yaml.safe_load((ROOT / "workflow/schemas/config.schema.yaml").read_text())
    assert schema["properties"][stage]["additionalProperties"] is False
    assert list((ROOT / "tests/stages").glob(f"test_{stage}*.py"))
    assert stage in (ROOT / "README.md").read_text()
    assert f"## {stage}" in (ROOT / "config/README.md").read_text()


def rules() -> list[tuple[str, str, str]]:
    """(rule file, step, shell text) of every rule that runs a step."""
    found = []
    for path in sorted((ROOT / "workflow/rules").glob("*.smk")):
        for block in re.split(r"\n(?= *rule | *checkpoint )", path.read_text()):
            shell = block.partition("    shell:")[2]
            step = re.search(r"python -m studiorecon (\w+\.\w+)", shell)
            if step:
                found.append((path.name, step.group(1), block))
    return found


@pytest.mark.parametrize(("file", "step", "block"), rules(), ids=[r[1] for r in rules()])
def test_rule_passes_exactly_what_its_step_takes(file: str, step: str, block: str) -> None:
    run = importlib.import_module(f"studiorecon.{step}").run
    parameters = inspect.signature(run).parameters
    shell = block.partition("    shell:")[2]
    given = {name.replace("-", "_") for name in re.findall(r"--([a-z][a-z0-9-]*)", shell)} - {"settings", "log"}
    # Optional options may reach the shell through a params value such as {params.given}.
    in_params = {name.replace("-", "_") for name in re.findall(r"--([a-z][a-z0-9-]*)", block)} - {"settings", "log"}
    required = {
        n for n, p in parameters.items() if p.default is inspect.Parameter.empty and n != "settings" and "None" not in str(p.annotation)
    }
    assert given <= set(parameters), "the rule passes an option the step does not have"
    assert required <= given | in_params, "the step needs an option the rule does not pass"
    assert f'code("{step}")' in block
    for directive in ("log:", "benchmark:", "container:", "resources:", "threads:"):
        assert directive in block, f"{file}: the rule of {step} has no {directive}"


@pytest.mark.parametrize("preset", ["", *sorted(p.name for p in (ROOT / "config/presets").glob("*.yaml"))])
def test_every_step_reads_its_settings_from_the_configuration(preset: str) -> None:
    config = yaml.safe_load((ROOT / "config/config.yaml").read_text())
    if preset:
        config = merged(config, yaml.safe_load((ROOT / "config/presets" / preset).read_text()) or {})
    from snakemake.utils import validate

    validate(config, str(ROOT / "workflow/schemas/config.schema.yaml"))
    for _, step, _ in rules():
        module = importlib.import_module(f"studiorecon.{step}")
        stage = step.split(".")[0]
        if hasattr(module, "Settings"):
            settings_module.load(module.Settings, config[stage], stage)


def merged(base: dict, over: dict) -> dict:
    return {**base, **{k: merged(base[k], v) if isinstance(v, dict) and isinstance(base.get(k), dict) else v for k, v in over.items()}}


def test_presets_set_only_what_differs() -> None:
    config = yaml.safe_load((ROOT / "config/config.yaml").read_text())
    for path in sorted((ROOT / "config/presets").glob("*.yaml")):
        for stage, section in (yaml.safe_load(path.read_text()) or {}).items():
            for key, value in section.items() if isinstance(section, dict) else []:
                assert key in config[stage], f"{path.name} sets {stage}.{key}, which config.yaml does not have"
                assert value != config[stage][key], f"{path.name} repeats the default of {stage}.{key}"


def test_top_level_holds_what_the_design_names() -> None:
    assert {name.split("/")[0] for name in tracked()} <= CARD | DEMANDED_BY_TOOLS


def test_no_registry_addresses_or_machine_paths() -> None:
    pattern = re.compile(r"https?://[^ ]*(py" + r"pi|python" + r"hosted|npm" + r"js)\.|/wo" + r"rk/|/ro" + r"ot/|/ho" + r"me/")
    for name in tracked():
        path = ROOT / name
        if path.is_file() and path.suffix in {".py", ".smk", ".md", ".yaml", ".yml", ".toml", ".txt", ""} and path.stat().st_size < 1e6:
            text = path.read_text(errors="ignore")
            assert not pattern.search(text), f"{name} holds {pattern.search(text).group(0)}"


# The doors to torch inside the package, opened only by ``device: cuda``.
ON_REQUEST = {"splatting.cuda_training"}


@cache
def body_of(path: Path) -> list[ast.stmt]:
    return ast.parse(path.read_text()).body


def test_steps_without_torch_do_not_import_it() -> None:
    for _, step, _ in rules():
        for module, path in code.reached([step], without=ON_REQUEST).items():
            for node in body_of(path):
                names = (
                    [a.name for a in node.names]
                    if isinstance(node, ast.Import)
                    else [node.module]
                    if isinstance(node, ast.ImportFrom)
                    else []
                )
                heavy = {str(n).split(".")[0] for n in names} & {"torch", "kornia", "open3d", "pycolmap"}
                assert not heavy, f"{module} imports {heavy} at top level"


def test_what_trains_on_cuda_is_imported_only_when_it_is_asked_for() -> None:
    for path in MODULES:
        outside = [node for node in ast.parse(path.read_text()).body if isinstance(node, (ast.Import, ast.ImportFrom))]
        assert not code.imported_at(outside) & ON_REQUEST, f"{name_of(path)} imports {ON_REQUEST} outside a function"


# Inputs that a step finds without being told: named in its settings, or part of the package.
FOUND_BY_THE_STEP = {
    ("render_shot", "followed"),
    ("render_shot", "stand_ins"),
    ("render_layers", "stand_ins"),
    ("studio_capture", "defaults"),
}


@pytest.mark.parametrize(("file", "step", "block"), rules(), ids=[r[1] for r in rules()])
def test_a_rule_takes_no_input_that_its_step_is_not_told_of(file: str, step: str, block: str) -> None:
    rule = re.search(r"(?:rule|checkpoint) (\w+):", block).group(1)
    lines = re.search(r"\n *input:\n(.*?)\n *(?:output|log|params):", block, re.DOTALL)
    told = block.partition("shell:")[2] + block.partition("params:")[2]
    deepest = min((len(line) - len(line.lstrip()) for line in lines.group(1).splitlines() if line.strip()), default=0) if lines else 0
    for name in re.findall(rf"^ {{{deepest}}}(\w+)=", lines.group(1), re.MULTILINE) if lines else []:
        assert f"input.{name}" in told or (rule, name) in FOUND_BY_THE_STEP, f"{file}: {rule} takes {name} and {step} is not told of it"
