# SPDX-License-Identifier: Apache-2.0
"""Every image has its folder, every rule and network its image, and pins agree with what is declared elsewhere."""

from __future__ import annotations

import ast
import re
import sys
from functools import cache
from pathlib import Path

import pytest
import tomllib
import yaml
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from packaging.version import Version
from studiorecon import code
from studiorecon.models.catalogue.registry import MODELS
from studiorecon.models.catalogue.selection import CANONICAL, CHOICES
from studiorecon.models.containers import definition

from tests.containers.resolve import recipe
from tests.made.sources import tree

ROOT = Path(__file__).resolve().parents[2]
IMAGES = yaml.safe_load((ROOT / "envs/images.yaml").read_text())
RULES = sorted((ROOT / "workflow/rules").glob("*.smk"))
# What a package is imported as.
PACKAGES = {
    "cv2": ("opencv-python-headless", "opencv-contrib-python-headless", "opencv-python"),
    "pxr": ("usd-core",),
    "yaml": ("pyyaml",),
    "OpenEXR": ("openexr",),
}
# Steps of networks, with the networks that they may be told to run; everything else runs in core or vision.
STEPS = {
    *((step, name) for choice in CHOICES.values() for step in choice.steps for name in choice.networks),
    ("humans.canonical", CANONICAL),
}
# They ask a network's adapter what it wants, and run in the core image.
ASKING = {"views.request", "views.fitted"}


def pins(name: str) -> dict[str, Requirement]:
    lines = (
        line.partition("#")[0].strip() for line in (ROOT / "envs" / name / "requirements.txt").read_text().splitlines()
    )
    found = [Requirement(line) for line in lines if line]
    return {canonicalize_name(r.name): r for r in found}


def test_images_and_folders_are_the_same() -> None:
    assert {p.name for p in (ROOT / "envs").iterdir() if p.is_dir()} == set(IMAGES)
    for name, entry in IMAGES.items():
        assert set(entry) == {"image", "version", "digest"}, name
        assert entry["digest"] == "" or re.fullmatch(r"sha256:[0-9a-f]{64}", entry["digest"])
        assert "." not in entry["image"].split("/")[0], "an address holds no registry"


@pytest.mark.parametrize("name", IMAGES)
def test_an_image_is_pinned_and_can_be_said_to_every_engine(name: str) -> None:
    for package, requirement in pins(name).items():
        assert requirement.url or [s.operator for s in requirement.specifier] == ["=="], (
            f"envs/{name}: {package} is not pinned"
        )
    text = (ROOT / "envs" / name / "Containerfile").read_text()
    recipe = definition(text)
    assert re.search(r"^From: (docker\.io|nvcr\.io)/\S+:\S+$", recipe, re.MULTILINE)
    for source, target in re.findall(r"^COPY (\S+) (\S+)$", text, re.MULTILINE):
        assert (ROOT / source).exists(), f"envs/{name} copies {source}, which is not there"
        assert target.startswith("/opt/studiorecon/")
    assert "COPY workflow/studiorecon /opt/studiorecon/workflow/studiorecon" in text
    assert "PYTHONPATH=/opt/studiorecon/workflow" in text


@pytest.mark.parametrize("name", IMAGES)
def test_what_comes_from_git_is_of_one_commit(name: str) -> None:
    text = (ROOT / "envs" / name / "Containerfile").read_text()
    for source in re.findall(r"git\+https://\S+", text):
        assert re.search(r"@(?:[0-9a-f]{7,40}|v\d[\d.]+)$", source), (
            f"envs/{name}: {source} is what its authors wrote last"
        )
    for folder in re.findall(r"git clone \S+ (\S+)", text):
        assert f"git -C {folder} checkout " in text, f"envs/{name}: {folder} is what its authors wrote last"
    # Compiled without a GPU in sight: for whom has to be said.
    if re.search(r"RUN .*(pytorch3d|apex|diff-gaussian|gsplat)", text):
        assert "TORCH_CUDA_ARCH_LIST" in text


def test_links_of_weights_leave_upstreams_own_folders_alone() -> None:
    text = (ROOT / "envs/comotion/Containerfile").read_text()
    links = re.findall(r"ln -s (.+?) (/opt/\S+)", text)
    # A link to a folder where a folder is ends up inside it.
    assert ("/weights/smpl/SMPL_NEUTRAL.pkl", "/opt/comotion/src/comotion_demo/data/smpl/SMPL_NEUTRAL.pkl") in links
    files = {f"/weights/{file.path}" for file in MODELS["comotion"].weights}
    assert {source for given, _ in links for source in given.split()} == files


def test_versions_agree_with_the_package() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert {entry["version"] for entry in IMAGES.values()} == {project["version"]}
    core = pins("core")
    declared = [Requirement(d) for d in project["dependencies"]]
    for wanted in declared:
        assert next(iter(core[canonicalize_name(wanted.name)].specifier)).version in wanted.specifier, (
            f"core pins another {wanted.name}"
        )
    for larger in ("vision", "driver"):
        has = {name: str(r) for name, r in pins(larger).items()}
        assert {name: str(r) for name, r in core.items()}.items() <= has.items(), f"{larger} lacks some of core"
    vision = pins("vision")
    for wanted in (Requirement(d) for d in project["optional-dependencies"]["gpu"]):
        assert next(iter(vision[canonicalize_name(wanted.name)].specifier)).version in wanted.specifier


@pytest.mark.parametrize("name", MODELS)
def test_a_networks_image_has_what_its_table_says(name: str) -> None:
    runtime = MODELS[name].runtime
    has = pins(runtime.image)
    text = (ROOT / "envs" / runtime.image / "Containerfile").read_text() + (
        ROOT / "envs" / runtime.image / "requirements.txt"
    ).read_text()
    # Of Fixer's image it is the base's, which also has what was compiled against it.
    assert ("torch" not in has) == (runtime.image == "fixer" or not runtime.torch)
    if "torch" in has:
        torch = Requirement(f"torch{runtime.torch if runtime.torch[0] in '<>=' else '==' + runtime.torch}")
        assert next(iter(has["torch"].specifier)).version in torch.specifier
    for pin in runtime.pins:
        if re.fullmatch(r"[\w.-]+([<>=]=?[\w.,<>=]+)?", pin):
            wanted = Requirement(pin)
            found = has.get(canonicalize_name(wanted.name))
            if found is not None:
                assert found.url or next(iter(found.specifier)).version in wanted.specifier, (
                    f"{runtime.image} pins another {wanted.name}"
                )
            else:
                assert pin in text, f"envs/{runtime.image} says nothing about {pin}"
        else:
            assert pin.split()[0] in text, f"envs/{runtime.image} says nothing about {pin}"
    if re.fullmatch(r"[0-9a-f]{7,}", runtime.commit):
        assert f"checkout {runtime.commit}" in text
    if not runtime.python.startswith(">"):
        assert recipe(runtime.image).python == runtime.python


@pytest.mark.parametrize(("step", "network"), sorted(pair for pair in STEPS if pair[0] not in ASKING))
def test_an_image_has_what_our_steps_import_there(step: str, network: str) -> None:
    has = pins(MODELS[network].runtime.image)
    for module, path in code.dependencies([step]).items():
        if module.startswith("models."):
            continue
        for node in tree(path).body:
            names = (
                [a.name for a in node.names]
                if isinstance(node, ast.Import)
                else [node.module]
                if isinstance(node, ast.ImportFrom)
                else []
            )
            for top in (
                {str(n).split(".")[0] for n in names} - set(sys.stdlib_module_names) - {"studiorecon", "__future__"}
            ):
                packages = PACKAGES.get(top, (top,))
                assert any(canonicalize_name(p) in has for p in packages), (
                    f"{module} imports {top}, which image {network} lacks"
                )


# What draws on a GPU and measures LPIPS: then a rule that draws runs in vision (networks.rasteriser_image).
ONLY_IN_VISION = {"torch", "gsplat", "kornia"}


def steps_and_images() -> list[tuple[str, str]]:
    """(step, image) of every rule that runs a step in an image of ours; networks' images are looked at by network,
    above."""
    found = set()
    for path in RULES:
        for block in re.split(r"\n(?= *(?:rule|checkpoint) )", path.read_text()):
            step = re.search(r"command\(\"(\w+\.\w+)\"\)", block)
            container = re.search(r"container:\n((?: +.*\n)+?) +threads:", block)
            if step and container:
                named = re.findall(r'(?<!_)image\("(\w+)"\)', container.group(1))
                found |= {
                    (step.group(1), name)
                    for name in [*named, *(["core", "vision"] if "rasteriser_image" in container.group(1) else [])]
                }
    return sorted(found)


@cache
def imported_anywhere(path: Path) -> set[str]:
    """Top names of what a module imports, in functions too; what only a type checker sees needs to be nowhere."""
    body = tree(path).body
    run = [s for s in body if not (isinstance(s, ast.If) and ast.unparse(s.test) == "TYPE_CHECKING")]
    nodes = list(ast.walk(ast.Module(run, [])))
    names = [a.name for node in nodes if isinstance(node, ast.Import) for a in node.names]
    names += [str(node.module) for node in nodes if isinstance(node, ast.ImportFrom)]
    return {name.split(".")[0] for name in names}


@pytest.mark.parametrize(("step", "image"), steps_and_images())
def test_an_image_has_what_a_step_imports_anywhere(step: str, image: str) -> None:
    """In functions too: what is imported late is missing late, hours into a run."""
    has = pins(image)
    allowed = {*sys.stdlib_module_names, "studiorecon", "__future__", *(ONLY_IN_VISION if image == "core" else ())}
    for module, path in code.dependencies([step]).items():
        if module.startswith("models."):
            continue
        for top in imported_anywhere(path) - allowed:
            packages = PACKAGES.get(top, (top,))
            assert any(canonicalize_name(p) in has for p in packages), (
                f"{module} imports {top}, which the image {image} of {step} lacks"
            )


def test_every_rules_container_exists() -> None:
    for path in RULES:
        for block in re.split(r"\n(?= *(?:rule|checkpoint) )", path.read_text()):
            if "shell:" not in block:
                continue
            container = re.search(r"container:\n((?: +.*\n)+?) +threads:", block)
            assert container, f"a rule of {path.name} names no container"
            for name in re.findall(r'(?<!_)image\("(\w+)"\)', container.group(1)):
                assert name in IMAGES
            assert re.search(r"image\(|no_container|None", container.group(1))
    assert {model.runtime.image for model in MODELS.values()} <= set(IMAGES)


def test_numpy_two_only_where_upstream_bears_it() -> None:
    for name in IMAGES:
        numpy = Version(next(iter(pins(name)["numpy"].specifier)).version)
        assert (numpy.major == 2) == (name in ("core", "driver", "vision"))


def test_weights_are_fetched_where_every_client_is() -> None:
    """``snakemake weights`` runs in this image: each way of fetching a file has its client there."""
    rule = (ROOT / "workflow/rules/weights.smk").read_text().partition("rule weights:")[2]
    (name,) = re.findall(r'image\("(\w+)"\)', rule)
    clients = {"hub": "huggingface-hub", "snapshot": "huggingface-hub", "torchvision": "torchvision"}
    for card in MODELS.values():
        for file in card.weights:
            wanted = file.remote.partition(":")[0] if file.how == "package" else clients.get(file.how)
            assert wanted is None or wanted in pins(name), f"{file.path} cannot be fetched in the image {name}"
