# SPDX-License-Identifier: Apache-2.0
"""Opens every file that a user brings; a file is either valid for its suffix or refused in one sentence.

Opening a file never runs a program (no pickles, no YAML tags). Memory is bounded by the file's own size or by a limit
below. ``scene.user_values`` checks the meaning of values, ``scene.numbered_files`` the order of numbered files.
"""

from __future__ import annotations

import csv
import io
import json
import math
import os
import pickletools
import re
import shlex
import tokenize
import warnings
import xml.etree.ElementTree as ElementTree
import zipfile
import zlib
from collections.abc import Container, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import yaml

from studiorecon.errors import UserError

if TYPE_CHECKING:
    import numpy as np
    from jaxtyping import Shaped

MAX_TEXT_BYTES = 2**30
"""The largest text (JSON, YAML, TOML, table) that is read: keypoints of a crowd over an hour have less."""
MAX_ARRAY_BYTES = 2**33
"""The largest size of one file's arrays in memory."""
_MAX_REPEATED = 200
_BRING = "bring the file itself"
_COPY = "it may have been copied only in part: copy it again, or write it again with the program that made it"
# Errors of parsing a damaged header, which is a Python literal.
_BROKEN_HEADER = (ValueError, TypeError, SyntaxError, OverflowError, RecursionError, MemoryError)
# Whole numbers of YAML 1.1 that are not in plain decimals: 010, 0x10, 0b1, 1:30.
_OTHER_BASE = re.compile(r"[-+]?(0[0-9xXbB_].*|.*:.*)")
_WIDE = {b"\xff\xfe": "UTF-16", b"\xfe\xff": "UTF-16"}


def not_permitted(path: Path, error: OSError | None = None, remedy: str = "") -> UserError:
    """The refusal of a file or folder that ``error`` keeps closed, with the command that opens it; or of a link to
    nothing."""
    if os.path.islink(path) and not os.path.exists(path):
        return UserError(f"{path} is a link to {path.readlink()}, which does not exist; {remedy or _BRING}")
    closed = next((folder for folder in reversed(path.absolute().parents) if not os.access(folder, os.X_OK)), None)
    why = error.strerror if error else "Permission denied"
    return UserError(f"{path} cannot be read ({why}); permit it: chmod -R u+rX {shlex.quote(str(closed or path))}")


def read_bytes(path: Path, most: int = MAX_ARRAY_BYTES, remedy: str = "") -> bytes:
    """The bytes of a regular file.

    Raises UserError, with ``remedy``, for a missing file, a folder, a device, a closed file, or more than ``most``
    bytes.
    """
    size = file_size(path, remedy)
    if size > most:
        raise UserError(f"{path} has {size / 2**20:.0f} MiB; at most {most / 2**20:.0f} MiB are read: is it the file?")
    return path.read_bytes()


def file_size(path: Path, remedy: str = "") -> int:
    """Size of a regular file in bytes; raises UserError as ``read_bytes`` does."""
    try:
        if path.is_dir():
            raise UserError(f"{path} is a folder where a file is expected; {remedy or 'name the file in it'}")
        if not path.exists() and not path.is_symlink():
            raise UserError(f"{path} is missing")
        if path.exists() and not path.is_file():
            raise UserError(f"{path} is no regular file; {remedy or _BRING}")
        if not os.access(path, os.R_OK):
            raise not_permitted(path, remedy=remedy)
        return path.stat().st_size
    except OSError as error:
        raise not_permitted(path, error, remedy) from None


def read_text(path: Path, remedy: str = "") -> str:
    r"""The text of a file in UTF-8, with or without a byte order mark, its lines ended by ``\n``.

    Raises UserError, with the line and ``remedy``, for UTF-16, binary files and other encodings.
    """
    data = read_bytes(path, MAX_TEXT_BYTES, remedy)
    if data[:2] in _WIDE:
        raise UserError(f"{path} is {_WIDE[data[:2]]} text; {remedy or 'save it as UTF-8'}")
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        raise UserError(
            f"{path} is not UTF-8 text (byte {data[error.start]:#04x} in line {line}); "
            f"{remedy or f'save it as UTF-8, or {_COPY}'}"
        ) from None
    if "\0" in text:
        line = text.count("\n", 0, text.index("\0")) + 1
        raise UserError(f"{path} is not text (a zero byte in line {line}); {remedy or _COPY}")
    return text.replace("\r\n", "\n").replace("\r", "\n")


def read_json(path: Path, remedy: str = _COPY) -> Any:
    """The value of a JSON file; raises UserError, ending in ``remedy``, for invalid or too deeply nested JSON.

    NaN and infinities, which detectors write, are left to ``scene.user_values``.
    """
    text = read_text(path, remedy if remedy is not _COPY else "")
    try:
        return json.loads(text, object_pairs_hook=_entries)
    except json.JSONDecodeError as error:
        raise UserError(f"{path} is not readable JSON ({error}); {remedy}") from None
    except RecursionError:
        raise UserError(f"{path} is not readable JSON (its lists are nested too deeply); {remedy}") from None
    except ValueError as error:
        raise UserError(f"{path} is not readable JSON ({first_line(error)}); {remedy}") from None


class PlainYaml(yaml.SafeLoader):
    """YAML 1.2 loader: numbers (010, 12:30, 1_0), truth values (no, on) and dates of YAML 1.1 stay text."""

    yaml_implicit_resolvers: ClassVar[dict[str, Any]] = {}


_INTEGER = r"[-+]?(?:0|[1-9][0-9]*)"
_REAL = rf"(?:{_INTEGER}(?:\.[0-9]*)?|[-+]?\.[0-9]+)(?:[eE][-+]?[0-9]+)?|[-+]?\.(?:inf|Inf|INF)|\.(?:nan|NaN|NAN)"
for _kind, _form, _first in (
    ("null", r"~|null|Null|NULL|", ("~", "n", "N", "")),
    ("bool", "true|True|TRUE|false|False|FALSE", tuple("tTfF")),
    ("int", _INTEGER, tuple("-+0123456789")),
    ("float", _REAL, tuple("-+.0123456789")),
    ("merge", "<<", ("<",)),
):
    PlainYaml.add_implicit_resolver(f"tag:yaml.org,2002:{_kind}", re.compile(f"(?:{_form})$"), _first)


def read_yaml(path: Path, loader: type = PlainYaml, *, comments: str = "") -> Any:
    """The contents of a YAML file, in plain types or those of ``loader``, without lines that begin with ``comments``.

    Raises UserError with the line, also for a repeated key.
    """
    text = read_text(path)
    if comments:
        text = "\n".join("" if line.startswith(comments) else line for line in text.split("\n"))
    try:
        reader = loader(text)
        _check_unique_keys(node := reader.get_single_node())
        return None if node is None else reader.construct_document(node)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        where = f"line {mark.line + 1}: " if mark else ""
        what = error.problem or error.context
        what = "a tab; indent with blanks" if what and r"'\t'" in what else what
        raise UserError(f"{path} is not valid YAML ({where}{what})") from None
    except RecursionError:
        raise UserError(f"{path} is not valid YAML (its lists are nested too deeply)") from None
    except (yaml.YAMLError, ValueError, TypeError, KeyError, AttributeError, OverflowError) as error:
        raise UserError(f"{path} is not valid YAML ({first_line(error)})") from None


def read_toml(path: Path) -> dict[str, Any]:
    """The tables of a TOML file; raises UserError."""
    import tomllib  # not in Python 3.10, which containers of networks use

    text = read_text(path)
    try:
        return tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        raise UserError(f"{path} is not valid TOML ({first_line(error)})") from None


def read_xml(path: Path) -> ElementTree.Element:
    """The root of an XML file in its declared encoding; raises UserError, also for entities, which can expand."""
    data = read_bytes(path, MAX_TEXT_BYTES)
    # Zero bytes are removed: UTF-16 has them between letters.
    if b"<!DOCTYPE" in (plain := data.replace(b"\0", b"")) or b"<!ENTITY" in plain:
        raise UserError(f"{path} declares entities, which no calibration needs; export it again")
    try:
        return ElementTree.fromstring(data)
    except (ElementTree.ParseError, ValueError, LookupError, RecursionError) as error:
        raise UserError(f"{path} is not valid XML ({first_line(error)}); {_COPY}") from None


def refuse_pickle_bomb(data: bytes) -> None:
    """Raises ValueError for a pickle that numbers its values beyond its own size: memory would be reserved for all."""
    if any(op.name.endswith("PUT") and (arg or 0) > len(data) for op, arg, _ in pickletools.genops(data)):
        raise ValueError("it numbers more values than it holds")


def read_rows(path: Path, columns: Iterable[str], delimiter: str = "\t") -> list[tuple[int, dict[str, str]]]:
    """(line, column → text) of every row of a table whose first line names the columns; empty lines are skipped.

    Raises UserError for a missing column of ``columns``, and for a row with more or fewer cells than the header.
    """
    wanted = list(columns)
    kind = {"\t": "tab", ",": "comma"}.get(delimiter, delimiter)
    reader = csv.reader(io.StringIO(read_text(path), newline=""), delimiter=delimiter)
    rows = []
    try:
        header = [name.strip() for name in next(reader, [])]
        if missing := [name for name in wanted if name not in header]:
            raise UserError(
                f"{path} has no column {missing[0]!r}; its header must be {' '.join(wanted)} ({kind}-separated)"
            )
        if twice := [name for name in wanted if header.count(name) > 1]:
            raise UserError(f"{path} has the column {twice[0]!r} twice; keep one")
        for cells in reader:
            if not any(cell.strip() for cell in cells):
                continue
            if len(cells) > len(header) and not any(cells[len(header) :]):
                cells = cells[: len(header)]
            if len(cells) != len(header):
                raise UserError(
                    f"{path}, line {reader.line_num}: {len(cells)} cells under {len(header)} columns; "
                    f"cells are {kind}-separated"
                )
            rows.append((reader.line_num, dict(zip(header, cells))))
    except csv.Error as error:
        raise UserError(f"{path}, line {reader.line_num}: not a table ({error})") from None
    return rows


def read_npz(
    path: Path,
    most: int = MAX_ARRAY_BYTES,
    *,
    names: Iterable[str] | None = None,
    but: Container[str] = (),
    remedy: str = _COPY,
) -> dict[str, Shaped[np.ndarray, " ..."]]:
    """The arrays of an npz by name: those of ``names`` (KeyError for a missing one), or all but those of ``but``.

    Raises UserError, with ``remedy``, for pickled objects, damage, and more than ``most`` bytes, before loading any.
    """
    file_size(path, "" if remedy is _COPY else remedy)
    try:
        with zipfile.ZipFile(path) as archive:
            members = [info for info in archive.infolist() if info.filename.endswith(".npy")]
            held = {info.filename.removesuffix(".npy"): info for info in members}
            if len(held) < len(members):
                raise UserError(f"{path} holds an array twice; {remedy}")
            wanted = {name: held[name] for name in names or held if name not in but}
            total = sum(info.file_size for info in wanted.values())
            if total > most:
                raise UserError(f"{path} holds {total / 2**20:.0f} MiB of arrays; at most {most / 2**20:.0f} are read")
            found = {}
            for name, info in wanted.items():
                with archive.open(info) as stream:
                    found[name] = _array(stream, info.file_size, f"{path}: array {name}", remedy)
            return found
    except (zipfile.BadZipFile, zlib.error, EOFError, OSError, RuntimeError, NotImplementedError, ValueError) as error:
        raise UserError(f"{path} is not a readable .npz ({first_line(error)}); {remedy}") from None


def read_npy(path: Path) -> Shaped[np.ndarray, " ..."]:
    """The array of an npy file; raises UserError as ``read_npz`` does."""
    size = file_size(path)
    if size > MAX_ARRAY_BYTES:
        raise UserError(f"{path} has {size / 2**20:.0f} MiB; at most {MAX_ARRAY_BYTES / 2**20:.0f} MiB are read")
    with open(path, "rb") as stream:
        return _array(stream, size, str(path))


@contextmanager
def user_file_context(path: Path | str, what: str) -> Iterator[None]:
    """Context for reading a file of the kind ``what``: a missing or wrong entry becomes a UserError that names both."""
    try:
        yield
    except UserError:
        raise
    except KeyError as error:
        raise UserError(f"{path} has no entry {error.args[0]!r}, which {what} has; {_COPY}") from None
    except (TypeError, ValueError, IndexError, AttributeError, ArithmeticError, RecursionError) as error:
        raise UserError(
            f"{path} is not laid out as {what} is ({first_line(error)}); write it again with the program that made it"
        ) from None
    except MemoryError:
        raise UserError(f"{path} needs more memory than there is; check that it is {what}") from None


def _array(stream: Any, held: int, where: str, remedy: str = _COPY) -> np.ndarray:
    """The array of a stream in npy's format of which ``held`` bytes exist."""
    import numpy as np  # takes 0.1 s, which plans that read only text save

    try:
        version = np.lib.format.read_magic(stream)
        read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        with warnings.catch_warnings():
            # Warnings about headers of Python 2, or damaged ones, do not help a user.
            warnings.simplefilter("ignore", UserWarning)
            shape, fortran, dtype = read(stream)
        if dtype.hasobject:
            raise UserError(f"{where} holds Python objects, which could run a program; save plain numbers")
        # The header may claim any size: memory is allocated only for bytes that exist.
        if any(extent < 0 for extent in shape) or math.prod(shape) * dtype.itemsize > held:
            raise UserError(f"{where} is cut off: its header promises {shape} of {dtype}; {remedy}")
        data = stream.read(math.prod(shape) * dtype.itemsize)
        flat = np.frombuffer(data, dtype, math.prod(shape)).copy()
        return flat.reshape(shape[::-1]).T if fortran else flat.reshape(shape)
    except (tokenize.TokenError, *_BROKEN_HEADER) as error:
        raise UserError(f"{where} is not a readable array ({first_line(error)}); {remedy}") from None


def _entries(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """The entries of a JSON object; raises ValueError for a repeated key."""
    found = dict(pairs)
    if len(found) < len(pairs):
        keys = [key for key, _ in pairs]
        twice = next(key for key in keys if keys.count(key) > 1)
        raise ValueError(f"it has {first_line(ValueError(repr(twice)))} twice; keep one")
    return found


def _check_unique_keys(node: Any) -> None:
    """Raises yaml.MarkedYAMLError for a repeated key, and for ambiguous numbers: 010 for 8, 1:30 for 90, {a: 0,5}."""
    seen: set[int] = set()
    waiting = [node]
    while waiting:
        here = waiting.pop()
        if here is None or id(here) in seen:
            continue
        seen.add(id(here))
        if here.tag == "tag:yaml.org,2002:int" and _OTHER_BASE.fullmatch(here.value):
            problem = (
                f"{here.value} would be read as {yaml.safe_load(here.value)}; quote a name, write a number plainly"
            )
            raise yaml.MarkedYAMLError(problem=problem, problem_mark=here.start_mark)
        if isinstance(here, yaml.SequenceNode):
            waiting += here.value
        elif isinstance(here, yaml.MappingNode):
            keys = set()
            for key, value in here.value:
                if isinstance(key, yaml.ScalarNode) and key.tag != "tag:yaml.org,2002:merge":
                    if key.value in keys:
                        raise yaml.MarkedYAMLError(problem=f"{key.value!r} twice", problem_mark=key.start_mark)
                    keys.add(key.value)
                    if here.flow_style and key.value.isdecimal() and value.tag.endswith(":null") and not value.value:
                        problem = f"{key.value} has no value; write a number with a point, not with a decimal comma"
                        raise yaml.MarkedYAMLError(problem=problem, problem_mark=key.start_mark)
                waiting += [key, value]


def first_line(error: BaseException) -> str:
    """A library's message on a damaged file, shortened to one line: some repeat the file's contents."""
    line = next(iter(str(error).partition("; use sys.")[0].splitlines()), "") or type(error).__name__
    return line if len(line) <= _MAX_REPEATED else line[: _MAX_REPEATED - 1] + "…"
