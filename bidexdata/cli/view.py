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
    rig: options.RigName = None,
    port: Annotated[
        int, typer.Option(min=1, max=65535, help="Where to listen; the next free port if taken.")
    ] = 8080,
    host: Annotated[
        str, typer.Option(help="Address to listen on; 0.0.0.0 shows it to the whole network.")
    ] = "127.0.0.1",
    export: Annotated[
        str | None,
        typer.Option(metavar="GRASP_ID", help="Write one grasp to --out instead; serve nothing."),
    ] = None,
    out: Annotated[
        Path | None, typer.Option(metavar="FILE.html", help="With --export: the page to write.")
    ] = None,
    as_json: options.Json = False,
    quiet: options.Quiet = False,
    debug: options.Debug = False,
) -> None:
    """Serve a page that shows objects and grasps until Ctrl-C.

    Where `bidexdata arms` has found motions, the page moves the arms from home to the lift.

    From another machine: ssh -L 8080:localhost:8080 MACHINE, then open http://127.0.0.1:8080.

    With --export, one grasp (the first digits of its id are enough) becomes one HTML file with its
    scene in 3D, its stages (with arms the motion) and its verdicts, which opens without a server.

    --json keys, printed when the page is up: url, host, port, path. With --export: grasp_id,
    object_id, out, bytes.
    """
    if (export is None) != (out is None):
        raise typer.BadParameter("--export GRASP_ID and --out FILE.html go together")
    if export is not None and out is not None:
        _write(path, export, out, protocol, rig, as_json=as_json, quiet=quiet)
    else:
        _serve(path, protocol, rig, host, port, as_json=as_json, quiet=quiet)


def _write(
    path: Path,
    wanted: str,
    out: Path,
    protocol: str | None,
    rig: str | None,
    *,
    as_json: bool,
    quiet: bool,
) -> None:
    from bidexdata.viewer.export import export_grasp

    made = export_grasp(path, wanted, out, protocol=protocol, rig=rig)
    lines = [f"{made.out}: grasp {made.grasp_id} of {made.object_id}, {made.bytes / 1e6:.1f} MB"]
    finish({**made._asdict(), "out": str(made.out)}, lines, as_json=as_json, quiet=quiet)


def _serve(
    path: Path,
    protocol: str | None,
    rig: str | None,
    host: str,
    port: int,
    *,
    as_json: bool,
    quiet: bool,
) -> None:
    import sys

    from bidexdata.viewer.app import serve, wait_until_interrupted

    server = serve(path, protocol=protocol, rig=rig, host=host, port=port, block=False)
    taken = server.get_port()
    if taken != port:
        warn(f"port {port} is taken; using {taken}")
    url = f"http://{'127.0.0.1' if host == '0.0.0.0' else host}:{taken}"
    data = {"url": url, "host": host, "port": taken, "path": str(path)}
    finish(data, [f"{path}: open {url} in a browser; Ctrl-C ends"], as_json=as_json, quiet=quiet)
    sys.stdout.flush()
    wait_until_interrupted(server)
