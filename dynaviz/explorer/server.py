"""The server of the explorer.

It listens on this machine alone, below a random token, and serves listed files only.
"""

from __future__ import annotations

import secrets
import socket
import threading
import time
from collections.abc import Callable
from importlib import metadata
from importlib.util import find_spec
from pathlib import Path
from types import TracebackType
from typing import Any

from dynaviz.errors import DynavizError, MissingDependency

try:
    import uvicorn
    from starlette.applications import Starlette
    from starlette.middleware import Middleware
    from starlette.middleware.trustedhost import TrustedHostMiddleware
    from starlette.requests import Request
    from starlette.responses import FileResponse, JSONResponse, Response, StreamingResponse
    from starlette.routing import Mount, Route
except ImportError:
    raise MissingDependency(
        "the explorer needs a web server. Install it with: pip install starlette uvicorn"
    ) from None

from dynaviz.explorer.answers import RRD, Explored, Query
from dynaviz.explorer.run import ExploredRun
from dynaviz.views.read.chunks import without_layout

HOME = "127.0.0.1"
PAGE = Path(__file__).with_name("page")
SCRIPTS = (
    "main.js",
    "cards.js",
    "correct.js",
    "dial.js",
    "dom.js",
    "keys.js",
    "plot.js",
    "places.js",
    "rectangle.js",
    "review.js",
    "server.js",
    "share.js",
    "state.js",
    "viewer.js",
    "whatif.js",
    "why.js",
)
FILES = {
    "index.html": "text/html",
    "review.html": "text/html",
    "style.css": "text/css",
    "review.css": "text/css",
    **dict.fromkeys(SCRIPTS, "text/javascript"),
}
VIEWER = {
    "widget.js": "text/javascript",
    "widget.css": "text/css",
    "re_viewer_bg.wasm": "application/wasm",
}
POLICY = (  # the browser itself refuses requests to other machines
    "default-src 'self'; script-src 'self' 'wasm-unsafe-eval'; style-src 'self' 'unsafe-inline'; "
    "img-src 'self' data: blob:; connect-src 'self' data: blob:; base-uri 'none'; form-action "
    "'none'"
)
HEADERS = {
    "Content-Security-Policy": POLICY,
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "Cache-Control": "private, no-cache",
}
SECONDS_TO_START = 20.0


def viewer_files() -> Path:
    """The folder with the files of Rerun's viewer for browsers, of the same version as rerun-sdk.

    Raises:
        MissingDependency: if they are not installed, or of another version.
    """
    found = find_spec("rerun_notebook")
    ours = metadata.version("rerun-sdk")
    fix = f"pip install rerun-notebook=={ours}"
    if found is None or found.origin is None:
        raise MissingDependency(f"the explorer needs Rerun's viewer. Install it with: {fix}")
    if (theirs := metadata.version("rerun-notebook")) != ours:
        raise MissingDependency(
            f"rerun-notebook {theirs} does not match rerun-sdk {ours}. Install it with: {fix}"
        )
    return Path(found.origin).with_name("static")


def application(explored: Explored, token: str) -> Starlette:
    """The page and its answers, all below ``/TOKEN/``.

    Args:
        explored: answers the page.
        token: the first part of each address.
    """
    static = viewer_files()
    files = {name: (PAGE / name, kind) for name, kind in FILES.items()}
    files[""] = files["index.html"]
    files |= {f"viewer/{name}": (static / name, kind) for name, kind in VIEWER.items()}
    recordings = {f"{letter}.rrd": run.path for letter, run in explored.runs.items()}

    def file(request: Request) -> Response:
        name = request.path_params["name"]
        if name in recordings:
            content = without_layout(recordings[name])
            return StreamingResponse(content, media_type=RRD, headers=HEADERS)
        known = files.get(name)
        if known is None:
            return Response("not found", 404, HEADERS)
        return FileResponse(known[0], media_type=known[1], headers=HEADERS)

    routes = [
        *(Route(f"/api/{name}", _json(answer)) for name, answer in explored.answers.items()),
        *(
            Route(f"/api/{name}", _json(change), methods=["POST"])
            for name, change in explored.changes.items()
        ),
        *(
            Route(f"/api/{name}", _bytes(answer, kind))
            for name, (answer, kind) in explored.contents.items()
        ),
        Route("/{name:path}", file),
    ]
    # not under another site's name
    hosts = Middleware(TrustedHostMiddleware, allowed_hosts=[HOME, "localhost"])
    return Starlette(routes=[Mount(f"/{token}", routes=routes)], middleware=[hosts])


def _json(answer: Callable[[Query], Any]) -> Callable[[Request], Response]:
    def respond(request: Request) -> Response:
        try:
            return JSONResponse(answer(request.query_params), headers=HEADERS)
        except DynavizError as error:
            return JSONResponse({"error": str(error)}, 400, HEADERS)

    return respond


def _bytes(answer: Callable[[Query], bytes], kind: str) -> Callable[[Request], Response]:
    def respond(request: Request) -> Response:
        try:
            return Response(answer(request.query_params), headers=HEADERS, media_type=kind)
        except DynavizError as error:
            return JSONResponse({"error": str(error)}, 400, HEADERS)

    return respond


class Explorer:
    """A running explorer; in a notebook it shows itself.

    Args:
        explored: the runs.
        port: to listen on; 0 for any free port.

    Attributes:
        url: address of the page, with its token.

    Raises:
        MissingDependency: if the viewer's files are not installed.
        DynavizError: if the port is taken, or the server does not start.
    """

    def __init__(self, explored: Explored, port: int = 0):
        self._explored = explored
        token = secrets.token_urlsafe(24)
        self._comparisons: list[Explorer] = []
        explored.compare = self._compare
        app = application(explored, token)
        self._socket = socket.socket()
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            self._socket.bind((HOME, port))
        except OSError as error:
            self._socket.close()
            raise DynavizError(f"--port {port}: {error.strerror}. Give another port") from None
        self.url = f"http://{HOME}:{self._socket.getsockname()[1]}/{token}/"
        self._server = uvicorn.Server(
            uvicorn.Config(app, log_level="error", lifespan="off", timeout_graceful_shutdown=1)
        )
        self._thread = threading.Thread(
            target=self._server.run, args=([self._socket],), name="explorer", daemon=True
        )
        self._thread.start()
        end = time.monotonic() + SECONDS_TO_START
        while not self._server.started:
            if time.monotonic() > end or not self._thread.is_alive():
                raise DynavizError("the server of the explorer did not start")
            time.sleep(0.01)

    def wait(self) -> None:
        """Serve until interrupted."""
        while self._thread.is_alive():
            self._thread.join(0.5)

    def close(self) -> None:
        """Stop serving; the page stays open, but answers no more."""
        self._server.should_exit = True
        self._thread.join(5.0)
        self._explored.close()
        self._socket.close()
        for comparison in self._comparisons:
            comparison.close()

    def _compare(self, run: ExploredRun, other: ExploredRun) -> str:
        """Serve the comparison of two runs, too; returns its address."""
        self._comparisons.append(Explorer(Explored(run, other)))
        return self._comparisons[-1].url

    def __enter__(self) -> Explorer:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def _repr_html_(self) -> str:
        return (
            f'<iframe src="{self.url}" style="width: 100%; height: 720px; border: 0" '
            'allow="clipboard-write"></iframe>'
        )
