# SPDX-License-Identifier: Apache-2.0
"""The house keeps its shape: who imports whom, what every stage has, and how files look."""

from __future__ import annotations

import ast
import importlib
import re
import subprocess
from pathlib import Path

import pytest
import yaml
from studiorecon import code
from studiorecon.__main__ import step_options
from studiorecon.configuration import settings as settings_module
from studiorecon.configuration.step_settings import find_section
from studiorecon.plan.command import command
from studiorecon.stages import STAGES

from tests.made.layout import ON_REQUEST, rules
from tests.made.sources import tree

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = ROOT / "workflow" / "studiorecon"
# Of tracks are those of detect.
WITHOUT_SETTINGS = {"tracks"}
# Below them the foundations, each of which imports only those before it, and of modules beside the folders only GROUND.
FOUNDATIONS = [
    "pages",
    "scene",
    "geometry",
    "camera_files",
    "footage",
    "images",
    "keypoints",
    "detector",
    "body",
    "estimate",
    "board",
    "rig",
]
FOUNDATIONS += ["splatting", "recursive"]
# What works with any network knows what networks are asked.
BESIDE = {"recursive": {"models"}}
GROUND = {"arrays", "configuration", "errors", "machine", "progress"}
CARD = {"Snakefile", "benchmarks", "workflow", "envs", "config", "resources", "tests", "docs", "README.md"}
DEMANDED_BY_TOOLS = {"pyproject.toml", "LICENSE", "profiles", ".ci", ".gitignore", ".github", "CITATION.cff"}
MODULES = sorted(p for p in PACKAGE.rglob("*.py"))


def tracked() -> list[str]:
    listing = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=False)
    return listing.stdout.split("\n")[:-1] if listing.returncode == 0 else []


def name_of(path: Path) -> str:
    return ".".join(path.relative_to(PACKAGE).with_suffix("").parts).removesuffix(".__init__")


def test_imports_go_one_way() -> None:
    wrong = []
    for path in MODULES:
        room = path.relative_to(PACKAGE).parts[0]
        for module in code.imports_of_file(path):
            other = module.split(".")[0]
            if room in FOUNDATIONS:
                below = {*FOUNDATIONS[: FOUNDATIONS.index(room) + 1], *GROUND, *BESIDE.get(room, ())}
                wrong += [f"{name_of(path)} imports {module}, which is not below it"] if other not in below else []
            if (room in STAGES or room == "studio") and other in {*STAGES, "studio"} - {room}:
                wrong.append(f"{name_of(path)} imports another stage: {module}")
    assert not wrong, "\n".join(wrong)


def imported_when_run(path: Path) -> list[str]:
    """Our modules that a file imports, but for those that only a type checker sees."""
    body = [s for s in tree(path).body if not (isinstance(s, ast.If) and ast.unparse(s.test) == "TYPE_CHECKING")]
    return [name for name in code.imports_of_statements(body) if code.module_path(name) is not None]


def test_no_module_imports_itself_by_way_of_others() -> None:
    imports = {name_of(path): imported_when_run(path) for path in MODULES}
    finished: set[str] = set()

    def visit(module: str, way: list[str]) -> None:
        assert module not in way, f"modules import each other: {' → '.join([*way[way.index(module) :], module])}"
        if module not in finished:
            for other in imports[module]:
                # A package's page of contents is imported with each of its modules.
                if not module.startswith(f"{other}."):
                    visit(other, [*way, module])
            finished.add(module)

    for module in imports:
        visit(module, [])


# Their contents are a list that is made of the files themselves.
LISTED_ELSEWHERE = {"calibration.formats", "models.adapters", "survey.effects"}


@pytest.mark.parametrize("page", [p for p in MODULES if p.name == "__init__.py" and p.parent != PACKAGE], ids=name_of)
def test_a_folder_s_first_page_names_every_module_in_it(page: Path) -> None:
    inside = {p.parent.name if p.name == "__init__.py" else p.stem for p in page.parent.glob("*.py") if p != page}
    inside |= {p.parent.name for p in page.parent.glob("*/__init__.py")}
    left_out = sorted(name for name in inside - {"__main__"} if f"``{name}``" not in page.read_text())
    assert not left_out or name_of(page) in LISTED_ELSEWHERE, f"{page.parent.name} does not say what these are"


def test_files_are_short_and_licensed() -> None:
    lines = {name_of(path): path.read_text().splitlines() for path in MODULES}
    assert not [name for name, own in lines.items() if own[0] != "# SPDX-License-Identifier: Apache-2.0"]
    assert not [name for name, own in lines.items() if len(own) > 380], "past 300 lines it is mostly two ideas"
    assert not [p for p in MODULES if re.search(r"(^|_)(utils?|helpers?|misc|manager|common)$", p.stem)]


def test_every_rule_file_is_a_stage_s_or_a_tool_s() -> None:
    files = {path.stem for path in (ROOT / "workflow/rules").glob("*.smk")}
    assert files == {"common", "studio", *STAGES, "placement", "sweep", "weights", "images"}


@pytest.mark.parametrize("stage", STAGES)
def test_every_stage_has_rules_settings_schema_and_tests(stage: str) -> None:
    assert (ROOT / f"workflow/rules/{stage}.smk").is_file()
    if stage not in WITHOUT_SETTINGS:
        assert stage in yaml.safe_load((ROOT / "config/config.yaml").read_text())
        schema = yaml.safe_load((ROOT / "workflow/schemas/config.schema.yaml").read_text())
        assert schema["properties"][stage]["additionalProperties"] is False
        assert f"## {stage}" in (ROOT / "config/README.md").read_text()
    assert list((ROOT / f"tests/{stage}").glob("test_*.py"))
    assert stage in (ROOT / "README.md").read_text()


# What rule files name once for several rules: constant → names of inputs.
SHARED_INPUTS = {
    name: set(re.findall(r'^    "(\w+)":', entries, re.MULTILINE))
    for path in sorted((ROOT / "workflow/rules").glob("*.smk"))
    for name, entries in re.findall(r"^([A-Z]+) = \{\n(.*?)^\}", path.read_text(), re.MULTILINE | re.DOTALL)
}


def names_in(block: str, directive: str) -> set[str]:
    """Names of what a rule has under ``input``, ``output`` or ``params``."""
    section = re.search(rf"^( *){directive}:\n((?:\1 +.*\n|\n)+)", block, re.MULTILINE)
    deeper = f"{section.group(1)}    " if section else ""
    names = set(re.findall(rf"^{deeper}(\w+)=", section.group(2), re.MULTILINE)) if section else set()
    shared = re.findall(r"\*\*([A-Z]+)", section.group(2)) if section else []
    return names.union(*(SHARED_INPUTS[name] for name in shared))


def reported_in(line: str, kind: str) -> set[str]:
    """Names of inputs, outputs, params or wildcards that a command line tells of."""
    return set(re.findall(rf"\{{{kind}\.(\w+)", line))


# Files that a step leaves beside those it is told of, inputs that it finds without being told (named in its settings,
# or part of the package), and params that only run it again.
WRITTEN_BESIDE = {
    "cameras_refine": {"intrinsics", "points", "heldout_intrinsics"},
    "cameras_held_out": {"heldout_intrinsics"},
    "calibration_network": {"intrinsics", "points"},
    "studio_capture": {"videos", "calibration", "keypoints", "plates", "capture"},
}
FOUND_BY_THE_STEP = {
    "report_page": {
        *("refinement", "sheet", "plates", "depths", "training_videos", "renders", "paths", "ledgers", "truth_maps"),
        *("heldout_videos", "heldout_render", "heldout_enhanced", "heldout_path"),
    },
    "render_shot": {"followed"},
    "studio_capture": {"defaults"},
}
RUNS_IT_AGAIN = {"report_page": {"swept"}}
# What has to be there first, or is a good moment, and is not read.
WAITED_FOR = {
    "background_kernels": {"videos"},
    "background_half": {"kernels"},
    "background_train": {"kernels"},
    "humans_train": {"kernels"},
    "depth_kernels": {"model"},
    "depth_room": {"kernels"},
}


@pytest.mark.parametrize(("file", "step", "block"), rules(), ids=[r[1] for r in rules()])
def test_rule_names_exactly_what_its_step_takes(file: str, step: str, block: str) -> None:
    rule, line = re.search(r"(?:rule|checkpoint) (\w+):", block).group(1), command(step)
    unread = FOUND_BY_THE_STEP.get(rule, set()) | WAITED_FOR.get(rule, set())
    assert names_in(block, "input") - unread == reported_in(line, "input")
    assert names_in(block, "output") - WRITTEN_BESIDE.get(rule, set()) == reported_in(line, "output")
    assert names_in(block, "params") - RUNS_IT_AGAIN.get(rule, set()) == reported_in(line, "params") | {"code"}
    declared = "".join(re.findall(r"^ *(?:output|log):.*?(?=^ *\w+:$)", block, re.MULTILINE | re.DOTALL))
    wildcards = {name for name in reported_in(line, "wildcards") if f"{{{name}}}" not in declared}
    assert not wildcards, f"{file}: no output or log of {rule} has {wildcards}"
    assert f'code("{step}")' in block
    for directive in ("log:", "benchmark:", "container:", "resources:", "threads:"):
        assert directive in block, f"{file}: the rule of {step} has no {directive}"


@pytest.mark.parametrize("step", sorted({r[1] for r in rules()}))
def test_a_command_line_says_what_run_takes_and_quotes_all_of_it(step: str) -> None:
    module, line = importlib.import_module(f"studiorecon.{step}"), command(step)
    options = [name.replace("-", "_") for name in re.findall(r"--([a-z0-9-]+) ", line)]
    assert sorted(options) == sorted(
        ["log", *(["settings"] * hasattr(module, "Settings")), *(name for name, *_ in step_options(module.run))]
    )
    assert all(field.endswith(":q") or field == "threads" for field in re.findall(r"\{([^}]*)\}", line))


def test_no_rule_writes_its_command_line_itself() -> None:
    for path in sorted((ROOT / "workflow/rules").glob("*.smk")):
        assert "python -m" not in path.read_text(), path.name


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
            settings_module.load(module.Settings, find_section(step, config), stage)


def merged(base: dict, over: dict) -> dict:
    return {
        **base,
        **{
            k: merged(base[k], v) if isinstance(v, dict) and isinstance(base.get(k), dict) else v
            for k, v in over.items()
        },
    }


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
    pattern = re.compile(
        r"https?://[^ ]*(py" + r"pi|python" + r"hosted|npm" + r"js)\.|/wo" + r"rk/|/ro" + r"ot/|/ho" + r"me/"
    )
    for name in tracked():
        path = ROOT / name
        if (
            path.is_file()
            and path.suffix in {".py", ".smk", ".md", ".yaml", ".yml", ".toml", ".txt", ""}
            and path.stat().st_size < 1e6
        ):
            text = path.read_text(errors="ignore")
            assert not pattern.search(text), f"{name} holds {pattern.search(text).group(0)}"


def test_steps_without_torch_do_not_import_it() -> None:
    for _, step, _ in rules():
        for module, path in code.dependencies([step], without=ON_REQUEST).items():
            for node in tree(path).body:
                names = (
                    [a.name for a in node.names]
                    if isinstance(node, ast.Import)
                    else [node.module]
                    if isinstance(node, ast.ImportFrom)
                    else []
                )
                heavy = {str(n).split(".")[0] for n in names} & {"torch", "kornia", "open3d", "pycolmap"}
                assert not heavy, f"{module} imports {heavy} at top level"


def test_what_trains_on_cuda_is_imported_only_when_it_is_requested() -> None:
    for path in MODULES:
        outside = [node for node in tree(path).body if isinstance(node, (ast.Import, ast.ImportFrom))]
        assert not code.imports_of_statements(outside) & ON_REQUEST, (
            f"{name_of(path)} imports {ON_REQUEST} outside a function"
        )


# Where only a part of the footage is used, the clocks say which before anybody is looked for in it; they then come from
# sound alone, so that nothing goes round in a circle. And calibration files that a user brings hang on keypoints at
# most, so people may tell the time by them.
ASKED_BEFORE = {"detect_keypoints": {"clocks"}, "detect_people": {"clocks"}, "clocks_offsets": {"calibration"}}
# What rules ask by name: constants of common.smk, methods of ``files``.
COMMON = (ROOT / "workflow/rules/common.smk").read_text()
ASKED = "".join((PACKAGE / "plan" / name).read_text() for name in ("rule_files.py", "user_inputs.py"))


def folders_named(text: str, known: frozenset[str] = frozenset()) -> set[str]:
    """Result folders that an input block names: by its paths, by constants, by methods of ``files``, and what these
    ask of each other and of checkpoints."""
    found = set(re.findall(r"results/\{+[^}]*\}+/(\w+)\b", text)) | set(re.findall(r"\{scene\}/(\w+)/", text))
    found |= {rule.partition("_")[0] for rule in re.findall(r"checkpoints\.(\w+)\.get", text)}
    constants = set(re.findall(r"\b[A-Z][A-Z_]+\b", text)) - known
    methods = set(re.findall(r"\b(?:files|self)\.(\w+)", text)) - known
    for name in constants | methods:
        defined = rf"^{name} = .*?(?=^\S)" if name in constants else rf"^    def {name}\(.*?(?=^    \S|\Z)"
        body = re.search(defined, COMMON if name in constants else ASKED, re.MULTILINE | re.DOTALL)
        if body:
            # What a function says of itself is not what it asks for.
            requested = re.sub(r'""".*?"""', "", body.group(0), flags=re.DOTALL)
            found |= folders_named(requested, known | {name})
    return found


@pytest.mark.parametrize("stage", STAGES)
def test_no_rule_takes_an_input_of_a_later_stage(stage: str) -> None:
    text = (ROOT / f"workflow/rules/{stage}.smk").read_text()
    for block in re.split(r"\n(?= *(?:use )?rule | *checkpoint )", text):
        rule = re.search(r"(?:rule|checkpoint) (\w+)", block)
        inputs = re.search(r"\n *input:\n(.*?)\n *(?:output|log|params):", block, re.DOTALL)
        if rule and inputs:
            later = folders_named(inputs.group(1)) & set(STAGES[STAGES.index(stage) + 1 :])
            later -= ASKED_BEFORE.get(rule.group(1), set())
            assert not later, f"{rule.group(1)} takes inputs from {later}, which come after {stage}"


def test_no_input_is_ancient() -> None:
    """Where the job before an ancient input runs, Snakemake does not ask whether the job behind it has a reason of its
    own: a changed setting would be passed over, and the film count as finished."""
    assert not [path.name for path in sorted((ROOT / "workflow/rules").glob("*.smk")) if "ancient(" in path.read_text()]


def test_settings_stand_in_the_order_of_the_stages() -> None:
    assert [name for name in yaml.safe_load((ROOT / "config/config.yaml").read_text()) if name in STAGES] == [
        stage for stage in STAGES if stage not in WITHOUT_SETTINGS
    ]


def test_no_test_takes_anything_from_another_test_file() -> None:
    """Except remedies: they damage the right inputs that the tests of all areas make."""
    taken = [
        f"{path.relative_to(ROOT)}: {node.module}"
        for path in sorted((ROOT / "tests").rglob("*.py"))
        if path.parent.name != "remedies"
        for node in ast.walk(tree(path))
        if isinstance(node, ast.ImportFrom) and re.search(r"(^|\.)test_\w+$", node.module or "")
    ]
    assert not taken, "take it from tests/made"


@pytest.mark.parametrize("path", sorted((ROOT / "benchmarks").glob("*.py")), ids=lambda p: p.stem)
def test_a_bench_still_finds_what_it_measures(path: Path) -> None:
    """Benches run by hand only: what they import must be there all the same."""
    importlib.import_module(f"benchmarks.{path.stem}")
