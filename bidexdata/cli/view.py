"""`bidexdata view`: the page in the browser."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from bidexdata.cli import options
from bidexdata.cli.report import finish, warn


def view(
    path: Annotated[Path, typer.Argument(metavar="LIBRARY|RUN|RELEASE", help="What to show.")],
    protocol: options.ProtocolName = None,
    port: Annotated[
        int, typer.Option(min=1, max=65535, help="Where to listen; the next free port if taken.")
    ] = 8080,
    host: Annotated[
        str, typer.Option(help="Address to listen on; 0.0.0.0 shows it to the whole network.")
    ] = "127.0.0.1",
    as_json: options.Json = False,
    quiet: options.Quiet = False,
    debug: options.Debug = False,
) -> None:
    """Serve a page that shows objects and grasps until Ctrl-C.

    From another machine: ssh -L 8080:localhost:8080 MACHINE, then open http://127.0.0.1:8080.

    --json keys, printed when the page is up: url, host, port, path.
    """
    import sys

    from bidexdata.viewer.app import serve, wait_until_interrupted

    server = serve(path, protocol=protocol, host=host, port=port, block=False)
    taken = server.get_port()
    if taken != port:
        warn(f"port {port} is taken; using {taken}")
    url = f"http://{'127.0.0.1' if host == '0.0.0.0' else host}:{taken}"
    data = {"url": url, "host": host, "port": taken, "path": str(path)}
    finish(data, [f"{path}: open {url} in a browser; Ctrl-C ends"], as_json=as_json, quiet=quiet)
    sys.stdout.flush()
    wait_until_interrupted(server)
