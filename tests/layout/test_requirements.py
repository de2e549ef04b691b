# SPDX-License-Identifier: Apache-2.0
"""What is imported is declared: the plain environment holds what steps import, an extra what some of them load on the
way."""

from __future__ import annotations

import ast
import re
import sys
from pathlib import Path

import tomllib
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from packaging.version import Version
from studiorecon import code
from studiorecon.machine.libraries import EXTRAS

from tests.made.layout import ON_REQUEST
from tests.made.sources import tree

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = ROOT / "workflow/studiorecon"
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
CONSTRAINTS = ROOT / "envs/constraints.txt"
MODULES = sorted(PACKAGE.rglob("*.py"))
# What a package is called on the registry, where that is not what it is imported as; llvmlite is a part of numba's.
CALLED = {
    "cv2": "opencv-contrib-python-headless",
    "yaml": "pyyaml",
    "skimage": "scikit-image",
    "llvmlite": "numba",
    "pxr": "usd-core",
}
OWN = {*sys.stdlib_module_names, "studiorecon", "snakemake_logger_plugin_studiorecon", "benchmarks", "tests"}


def names(requirements: list) -> set[str]:
    return {canonicalize_name(Requirement(r).name) for r in requirements if isinstance(r, str)}


PLAIN = names(PROJECT["project"]["dependencies"])
GROUPS = PROJECT["dependency-groups"]
OPTIONAL = {extra: names(wanted) for extra, wanted in PROJECT["project"]["optional-dependencies"].items()}
DRIVER = OPTIONAL.pop("run")


def imports(tree: ast.AST) -> set[str]:
    """Packages that are imported somewhere in a syntax tree, as they are called on the registry."""
    found = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found |= {alias.name.partition(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            found.add(node.module.partition(".")[0])
    return {str(canonicalize_name(CALLED.get(name, name))) for name in found - OWN}


def outside_functions(tree: ast.Module) -> ast.Module:
    return ast.Module([node for node in tree.body if isinstance(node, ast.Import | ast.ImportFrom)], [])


class Executed(ast.NodeTransformer):
    """Takes out what only a type checker sees."""

    def visit_If(self, node: ast.If) -> ast.AST | None:
        return None if ast.unparse(node.test) == "TYPE_CHECKING" else self.generic_visit(node)


def test_what_the_package_imports_is_declared() -> None:
    for path in MODULES:
        assert imports(Executed().visit(ast.parse(path.read_text()))) <= PLAIN.union(*OPTIONAL.values()), path


def test_what_steps_import_at_once_is_in_the_plain_environment() -> None:
    rules = "".join(path.read_text() for path in sorted((ROOT / "workflow/rules").glob("*.smk")))
    steps = set(re.findall(r"command\(\"(\w+\.\w+)\"\)", rules))
    assert len(steps) > 30
    for path in code.dependencies(steps, without=ON_REQUEST).values():
        assert imports(outside_functions(tree(path))) <= PLAIN, path


def test_what_the_workflow_imports_is_declared() -> None:
    for path in [ROOT / "Snakefile", *sorted((ROOT / "workflow/rules").glob("*.smk"))]:
        first = re.findall(r"^(?:import|from) (\w+)", path.read_text(), re.MULTILINE)
        wanted = {str(canonicalize_name(CALLED.get(name, name))) for name in set(first) - OWN}
        assert wanted <= PLAIN | DRIVER, path.name


def test_what_tests_import_is_declared() -> None:
    everything = PLAIN.union(*OPTIONAL.values(), DRIVER, names(GROUPS["test"]))
    for path in sorted((ROOT / "tests").rglob("*.py")):
        if path.parent.name != "gpu":
            assert imports(outside_functions(tree(path))) <= everything, path.name


def test_the_first_command_is_light_and_the_second_adds_to_it() -> None:
    assert PROJECT["tool"]["uv"]["default-groups"] == ["run"]
    assert GROUPS["run"] == ["studiorecon[run]"]
    assert {"include-group": "run"} in GROUPS["test"]
    heavy = {"torch", "torchvision", "kornia", "open3d", "torchmetrics", "scikit-image"}
    assert not heavy & (PLAIN | DRIVER)


def test_a_library_that_does_not_load_names_an_extra_that_has_it() -> None:
    for library, extra in EXTRAS.items():
        assert canonicalize_name(CALLED.get(library, library)) in OPTIONAL[extra]
        assert canonicalize_name(CALLED.get(library, library)) not in PLAIN
    assert {canonicalize_name(CALLED.get(library, library)) for library in EXTRAS} == set().union(*OPTIONAL.values())


def test_the_tested_versions_are_within_what_is_declared() -> None:
    text = CONSTRAINTS.read_text()
    assert "://" not in text, "no addresses"
    tested = [Requirement(line.partition("#")[0]) for line in text.splitlines() if line.partition("#")[0].strip()]
    held = {canonicalize_name(r.name) for r in tested}
    project = PROJECT["project"]
    declared = [
        *project["dependencies"],
        *project["optional-dependencies"]["run"],
        *(r for r in GROUPS["test"] if isinstance(r, str)),
    ]
    for wanted in map(Requirement, declared):
        assert canonicalize_name(wanted.name) in held, (
            f"{wanted.name} has no tested version (the head of constraints.txt says how)"
        )
        for pin in tested:
            if canonicalize_name(pin.name) == canonicalize_name(wanted.name):
                assert Version(next(iter(pin.specifier)).version) in wanted.specifier, (
                    f"{pin} is not what pyproject.toml asks for"
                )


def test_the_core_image_has_the_tested_versions() -> None:
    tested = [
        Requirement(line.partition("#")[0])
        for line in CONSTRAINTS.read_text().splitlines()
        if line.partition("#")[0].strip()
    ]
    there = {
        "python_full_version": "3.11.9",
        "python_version": "3.11",
        "sys_platform": "linux",
        "platform_machine": "x86_64",
    }
    held = {canonicalize_name(r.name): r.specifier for r in tested if r.marker is None or r.marker.evaluate(there)}
    for line in (ROOT / "envs/core/requirements.txt").read_text().splitlines():
        if line and not line.startswith("#"):
            pin = Requirement(line)
            assert held[canonicalize_name(pin.name)] == pin.specifier, (
                f"envs/core pins {pin}, and constraints.txt another"
            )


def test_steps_that_share_work_among_threads_call_no_kernel_that_does_so_itself() -> None:
    """numba's own threads end the process when two callers want them at once (and ``__main__`` takes no others)."""
    for path in MODULES:
        if "ThreadPoolExecutor" in path.read_text():
            step = ".".join(path.relative_to(PACKAGE).with_suffix("").parts)
            for module, reached in code.dependencies([step]).items():
                assert "parallel=True" not in reached.read_text(), (
                    f"{step} runs threads and reaches the parallel kernels of {module}"
                )
