# SPDX-License-Identifier: Apache-2.0
"""The window as an app: its page, the files of results, and what its buttons ask for."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.requests import ClientDisconnect, Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Route

from studiorecon.cli.real_demo import TAKE, fetch_take
from studiorecon.cli.snakemake_call import snakemake_command
from studiorecon.errors import UserError
from studiorecon.home import RESOURCES
from studiorecon.machine.crash_report import fault_sentence, keep_trace
from studiorecon.machine.resource_errors import describe_resource_error
from studiorecon.progress import LATEST
from studiorecon.scene.files import read_table
from studiorecon.window import projects, runs, shots
from studiorecon.window.serving import file_response

# Scripts and styles come from here alone; pictures may also be made by the page.
_POLICY = "default-src 'self'; img-src 'self' data:; object-src 'none'; base-uri 'none'; frame-ancestors 'self'"
# Bytes that are collected before they are written, so that a drop of gigabytes writes in large pieces.
_PIECE = 1 << 22


def build_app() -> Starlette:
    """The app for the current folder; the gate of ``serving`` belongs before it."""
    return Starlette(
        routes=[
            Route("/", _page),
            Route("/window/{file}", lambda request: file_response(RESOURCES, request.url.path, request.scope)),
            Route("/results/{file:path}", lambda request: file_response(Path(), request.scope["path"], request.scope)),
            Route(
                "/api/projects", _answers(lambda _: {"folder": str(Path.cwd()), "projects": projects.list_projects()})
            ),
            Route("/api/run", _answers(_run_state)),
            Route("/api/project/{name}", _answers(_project)),
            Route("/api/presets/{name}", _answers(lambda request: list(projects.presets(request.path_params["name"])))),
            Route("/api/thumbnail/{name}/{camera}", _thumbnail),
            Route("/api/snapshot/{name}", _snapshot),
            Route("/api/new", _changes(lambda given: projects.new_project(given["name"])), methods=["POST"]),
            Route("/api/link", _changes(lambda given: projects.link_folder(given["folder"])), methods=["POST"]),
            Route("/api/upload/{name}", _upload, methods=["POST"]),
            Route("/api/start", _changes(_start), methods=["POST"]),
            Route("/api/takes", _answers(_takes)),
            Route("/api/takes", _changes(_start_takes), methods=["POST"]),
            Route("/api/real", _changes(_fetch_real), methods=["POST"]),
            Route("/api/stop", _changes(lambda _: runs.stop_run()), methods=["POST"]),
            Route(
                "/api/capture",
                _changes(lambda given: projects.write_capture_yaml(given["name"], given["text"])),
                methods=["POST"],
            ),
            Route("/api/identities/{name}", _answers(_tracks)),
            Route("/api/film/{name}/{camera}", _film),
            Route("/api/identities", _changes(_correct), methods=["POST"]),
            Route("/api/shots", _changes(lambda given: shots.save_shot(**given)), methods=["POST"]),
        ],
        exception_handlers={UserError: _refused, Exception: _failed},
    )


def _answers(look: Callable[[Request], Any]) -> Callable[[Request], Response]:
    return lambda request: JSONResponse(look(request))


def _changes(change: Callable[[dict[str, Any]], Any]) -> Callable[[Request], Any]:
    async def answer(request: Request) -> Response:
        given = await request.json()
        return JSONResponse(await run_in_threadpool(change, given))

    return answer


def _refused(_: Request, error: Exception) -> Response:
    return JSONResponse({"error": str(error)}, 400)


def _failed(_: Request, error: Exception) -> Response:
    return JSONResponse({"error": describe_resource_error(error) or fault_sentence(error, keep_trace(error))}, 500)


def _page(request: Request) -> Response:
    found = file_response(RESOURCES, "/window/index.html", request.scope)
    found.headers["content-security-policy"] = _POLICY
    return found


def _project(request: Request) -> dict[str, Any]:
    name = request.path_params["name"]
    return {**projects.describe(name), "last": runs.last_run(name), "run": runs.current_run()}


def _run_state(_: Request) -> dict[str, Any]:
    run = runs.current_run()
    look = Path("logs") / run["scene"] / "background/train" / LATEST if run else Path(LATEST)
    return {"run": run, "snapshot": look.stat().st_mtime_ns if look.is_file() else 0}


def _thumbnail(request: Request) -> Response:
    return Response(projects.thumbnail(**request.path_params), media_type="image/jpeg")


def _snapshot(request: Request) -> Response:
    name = projects.find_project(request.path_params["name"])
    return file_response(Path("logs"), f"{name}/background/train/{LATEST}", request.scope)


def _command(given: dict[str, Any], goal: str = "") -> list[str]:
    """The call of a project's run, with its settings files, and the preset of its last run where none is chosen."""
    from studiorecon.cli.takes import rig_again  # loads numerical libraries, for which the window does not wait

    name = given["name"]
    folder, own = projects.find_project(name), (projects.settings_file(name), shots.shots_file(name))
    preset = given["preset"] if "preset" in given else runs.last_run(name)["preset"]
    overlays = [str(file) for file in own if file.is_file()]
    rest = [*(["--configfile", *overlays] if overlays else []), "--config", f"scene={name}", *rig_again(folder)[0]]
    return snakemake_command("" if goal == "film" else goal, str(folder), "all", preset or None, rest)


def _start(given: dict[str, Any]) -> None:
    runs.start_run(given["goal"], given["name"], _command(given, given["goal"]))


def _takes(_: Request) -> dict[str, Any]:
    from studiorecon.cli.takes import COLUMNS, TABLE

    return {"run": runs.current_run(), "rows": read_table(TABLE, COLUMNS) if TABLE.is_file() else []}


def _start_takes(given: dict[str, Any]) -> None:
    folders = [f"./{projects.find_project(name)}" for name in given["names"]]
    preset = ["--preset", given["preset"]] if given["preset"] else []
    runs.start_run("takes", "", [sys.executable, "-m", "studiorecon.cli.command", "run", *folders, *preset])


def _fetch_real(_: dict[str, Any]) -> str:
    fetch_take(Path(TAKE))
    return TAKE


def _tracks(request: Request) -> dict[str, Any]:
    from studiorecon.window import people  # loads the reader of films, for which the window does not wait

    return people.read_tracks(projects.find_project(request.path_params["name"]).name)


def _film(request: Request) -> Response:
    from studiorecon.window import people

    film = people.camera_film(**request.path_params)
    return file_response(film.parent, film.name, request.scope)


def _correct(given: dict[str, Any]) -> dict[str, Any]:
    from studiorecon.window import people

    file = people.save_identities(given["name"], given["rows"])
    return {"file": file, "planned": runs.planned_jobs(_command(given))}


async def _upload(request: Request) -> Response:
    """A file, streamed to a temporary name; nothing stays of one that did not arrive whole."""
    path = await run_in_threadpool(
        projects.upload_path, request.path_params["name"], request.query_params.get("path", "")
    )
    partial = path.with_name(f"{path.name}.part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with partial.open("wb") as file:
            piece = bytearray()
            async for chunk in request.stream():
                piece += chunk
                if len(piece) >= _PIECE:
                    await run_in_threadpool(file.write, bytes(piece))
                    piece.clear()
            await run_in_threadpool(file.write, bytes(piece))
        os.replace(partial, path)
    except ClientDisconnect:
        partial.unlink(missing_ok=True)
        return Response(status_code=400)
    except OSError as error:
        partial.unlink(missing_ok=True)
        raise UserError(f"{path.name} was not copied: {describe_resource_error(error) or error.strerror}") from None
    return JSONResponse(path.as_posix())
