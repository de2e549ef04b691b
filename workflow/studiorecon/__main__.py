# SPDX-License-Identifier: Apache-2.0
"""``python -m studiorecon STAGE.STEP --settings JSON [--log FILE] --NAME VALUE ...``

Imports only ``studiorecon.STAGE.STEP`` and calls its ``run(settings, ...)``. Every keyword of ``run`` is an option of
the same name (underscores become dashes); its annotation says how the text is read: ``Path``, ``str``, ``int``,
``float``, or a list of one of them. ``list[Path]`` may be empty, ``Path | None`` may be left out. A keyword that is a
dataclass of such is as many options as it has fields. By hand ``--settings config/config.yaml`` will do.
"""

from __future__ import annotations

import argparse
import dataclasses
import importlib
import inspect
import json
import os
import sys
import traceback
import types
import typing
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

from studiorecon.configuration import settings as settings_module
from studiorecon.configuration.step_settings import find_section
from studiorecon.errors import UserError
from studiorecon.machine.changed_files import changed_files, record_files
from studiorecon.machine.crash_report import fault_sentence, keep_trace
from studiorecon.machine.libraries import install_remedy, missing_library
from studiorecon.machine.output import unbroken_output
from studiorecon.machine.resource_errors import describe_resource_error, memory_note
from studiorecon.models.catalogue.sandbox import confine_process
from studiorecon.progress import LOGGER, fail, log_to, warn
from studiorecon.scene.names import as_paths
from studiorecon.signature import Written

_MAX_PIXELS = 2**28
# ``kernel_cache``, by name: imports here are part of every step's digest, and the place of machine code changes no
# result. numba's own locators follow for functions of other packages.
_OWN = "studiorecon.machine.kernel_cache.ByContent"
_NUMBAS = "InTreeCacheLocator,UserWideCacheLocator,IPythonCacheLocator"
KERNELS = {"NUMBA_CACHE_LOCATOR_CLASSES": f"{_OWN},UserProvidedCacheLocator,{_NUMBAS}"}
"""Numba's variable for the place of machine code."""


def main(argv: list[str] | None = None) -> int:
    """Run one step; the exit status is 0 when it finished, 1 when it refused or failed."""
    argv = list(sys.argv[1:] if argv is None else argv)
    try:
        with unbroken_output():
            return _main(argv)
    except Exception as error:  # before the step runs, or in its log
        sentence = describe_resource_error(error) or fault_sentence(error, keep_trace(error))
        print(f"{' '.join(argv[:1])}: {sentence}", file=sys.stderr, flush=True)
        return 1


def _main(argv: list[str]) -> int:
    if not argv or argv[0] in ("-h", "--help") or "." not in argv[0]:
        print(__doc__)
        return 0 if argv and argv[0] in ("-h", "--help") else 2
    step = argv[0]
    _keep_to_the_threads_given()
    _keep_byte_code()
    confine_process()
    try:
        module = importlib.import_module(f"studiorecon.{step}")
        run = module.run
    except (ImportError, OSError, AttributeError) as error:
        if describe_resource_error(error) is not None:
            raise
        if missing_library(error) is not None:
            return _cannot_load(step, error, argv)
        if not isinstance(error, AttributeError) and not f"studiorecon.{step}".startswith(
            str(getattr(error, "name", None))
        ):
            raise
        print(f"studiorecon: there is no step {step!r}; the rules in workflow/rules name them all", file=sys.stderr)
        return 2
    options = _parse(step, run, argv[1:])
    log = options.pop("log")
    with log_to(step, log):
        return _run(module, step, options, log)


def _keep_to_the_threads_given() -> None:
    # Snakemake sets OMP_NUM_THREADS to a job's share of the cores, but numba reads only its own variable; jobs that
    # each use every core slow each other down many times over. It must be set before numba is first imported.
    given = os.environ.get("OMP_NUM_THREADS", "")
    if "numba" not in sys.modules and given.isdigit() and 0 < int(given) <= (os.cpu_count() or 1):
        os.environ.setdefault("NUMBA_NUM_THREADS", given)
    # numba's own threads come with its wheel. The others are the system's (libgomp), which a bare machine lacks, and
    # which wait for each other in busy loops: several times slower when two jobs share the cores.
    os.environ.setdefault("NUMBA_THREADING_LAYER", "workqueue")
    for variable, chosen in KERNELS.items():
        os.environ.setdefault(variable, chosen)
    # numpy's linear algebra waits in busy loops as well: on the small matrices here its threads cost time and gain none
    # (filming the demo's studio takes 1.8 times the processor time with two), and their number changes last bits.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    # Pictures of more pixels than any camera's are damaged or an attack on memory: a few bytes can claim any size.
    os.environ.setdefault("OPENCV_IO_MAX_IMAGE_PIXELS", str(_MAX_PIXELS))


def _keep_byte_code() -> None:
    # If byte code may not be next to the sources (PYTHONDONTWRITEBYTECODE, as in many images), each of a film's hundred
    # short processes would compile every module it imports, up to two seconds of it: the run keeps it among its own
    # working files instead.
    if sys.dont_write_bytecode and Path(".snakemake").is_dir():
        sys.pycache_prefix, sys.dont_write_bytecode = str(Path(".snakemake/bytecode").resolve()), False


def _run(module: types.ModuleType, step: str, options: dict, log: Path | None) -> int:
    try:
        values = _section(options.pop("settings"), step)
        settings_type = module.Settings if dataclasses.is_dataclass(getattr(module, "Settings", None)) else None
        if settings_type is not None:
            options["settings"] = settings_module.load(settings_type, values, step.split(".")[0])
        for changed in changed_files(step_paths(module.run, options, Path)):
            warn(changed)
        # Imported late: numpy, which it loads, reads once how many threads it may use.
        from studiorecon.scene.files import remove_remains

        outputs = list(step_paths(module.run, options, Written))
        for path in outputs:
            remove_remains(path)
        module.run(**build_arguments(module.run, options))
        record_files(step, outputs)
    except UserError as refusal:
        fail(f"{step}: {refusal}")
    except Exception as error:
        if (sentence := describe_resource_error(error)) is not None:
            fail(f"{step}: {sentence}")
        elif missing_library(error) is not None:
            fail(f"{step}: {_sentence(error)}")
        else:
            if log is None:
                print(traceback.format_exc(), file=sys.stderr)
            LOGGER.debug(traceback.format_exc())
            fail(f"{step}: {fault_sentence(error, log)}")
    else:
        return 0
    if (note := memory_note()) is not None:
        fail(f"{step}: {note}")
    return 1


def _sentence(error: Exception) -> str:
    library = missing_library(error) or ""
    return (
        f"the library {library} cannot be loaded "
        f"({next(iter(str(error).splitlines()), 'no reason given')}); {install_remedy(library)}"
    )


def _cannot_load(step: str, error: Exception, argv: list[str]) -> int:
    # Without the step its options are unknown: only the log's is parsed.
    log = argparse.ArgumentParser(add_help=False, allow_abbrev=False)
    log.add_argument("--log", type=Path)
    path = log.parse_known_args(argv)[0].log
    print(text := f"{step}: {_sentence(error)}", file=sys.stderr, flush=True)
    if path is not None:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text + "\n", encoding="utf-8")
    return 1


def _section(given: str, step: str) -> dict:
    """A step's settings, given as JSON or as a configuration file that has a section for its stage."""
    if not given.endswith((".yaml", ".yml")):
        return json.loads(given)
    import yaml  # only by hand: rules pass JSON

    path = Path(given)
    if not path.is_file():
        raise UserError(f"settings file {path} is missing")
    content = yaml.safe_load(path.read_text(encoding="utf-8"))
    found = find_section(step, content) if isinstance(content, dict) else {}
    if not found:
        raise UserError(f"settings file {path} has no section {step.split('.')[0]}")
    return found


def _parse(step: str, run: typing.Callable, argv: list[str]) -> dict:
    parser = argparse.ArgumentParser(prog=f"python -m studiorecon {step}", description=inspect.getdoc(run))
    parser.add_argument(
        "--settings",
        default="{}",
        help="this step's section of the configuration as JSON, or a configuration file (config/config.yaml)",
    )
    parser.add_argument("--log", type=Path, default=None, help="file that receives every sentence of the step")
    for name, hint, default in step_options(run):
        kind, is_list, optional = _read_annotation(hint)
        required = default is dataclasses.MISSING and not optional and not is_list
        default = [] if is_list else None if default is dataclasses.MISSING else default
        extra = {"nargs": "*"} if is_list else {}
        parser.add_argument(
            "--" + name.replace("_", "-"), dest=name, type=_plain(kind), required=required, default=default, **extra
        )
    return vars(parser.parse_args(as_paths(argv)))


def step_options(run: Callable) -> Iterator[tuple[str, Any, Any]]:
    """Name, type and default (or ``dataclasses.MISSING``) of every option of a step except its settings."""
    hints = typing.get_type_hints(run, include_extras=True)
    for name, parameter in inspect.signature(run).parameters.items():
        if name == "settings":
            continue
        if dataclasses.is_dataclass(hints[name]):
            kinds = typing.get_type_hints(hints[name], include_extras=True)
            yield from ((field.name, kinds[field.name], field.default) for field in dataclasses.fields(hints[name]))
        else:
            given = parameter.default
            yield name, hints[name], dataclasses.MISSING if given is inspect.Parameter.empty else given


def step_paths(run: Callable, options: Mapping[str, Any], role: Any) -> list[Path]:
    """The paths among a step's options that are its inputs (``role`` is ``Path``) or that it writes (``Written``)."""
    found = [options.get(name) for name, hint, _ in step_options(run) if _read_annotation(hint)[0] == role]
    return [path for given in found for path in (given if isinstance(given, list) else [given]) if path is not None]


def build_arguments(run: Callable, options: Mapping[str, Any]) -> dict[str, Any]:
    """The keywords of ``run`` from its options; options that are fields of a dataclass are combined."""
    keywords = dict(options)
    hints: dict[str, Any] = typing.get_type_hints(run)
    for name, kind in hints.items():
        if name not in ("settings", "return") and dataclasses.is_dataclass(kind):
            own = [field.name for field in dataclasses.fields(kind) if field.name in keywords]
            record: Callable[..., Any] = hints[name]
            keywords[name] = record(**{field: keywords.pop(field) for field in own})
    return keywords


def _read_annotation(hint: typing.Any) -> tuple[type, bool, bool]:
    optional = False
    if typing.get_origin(hint) in (typing.Union, types.UnionType):
        optional = True
        hint = next(a for a in typing.get_args(hint) if a is not type(None))
    if typing.get_origin(hint) is list:
        return typing.get_args(hint)[0], True, optional
    return hint, False, optional


def _plain(kind: Any) -> Any:
    """The type without its role."""
    return typing.get_args(kind)[0] if typing.get_origin(kind) is typing.Annotated else kind


if __name__ == "__main__":
    sys.exit(main())
