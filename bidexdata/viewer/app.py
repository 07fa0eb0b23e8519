"""Serve the viewer: one process, any number of browsers, one page each.

The server listens on this machine only unless told otherwise. From elsewhere, use an SSH tunnel:
`ssh -L 8080:localhost:8080 MACHINE`.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from bidexdata.errors import NotUsable
from bidexdata.runs.browse import Browsable, open_browsable
from bidexdata.viewer.catalog import Catalog
from bidexdata.viewer.page import Page
from bidexdata.viewer.page_camera import PageCamera
from bidexdata.viewer.server import (
    DEFAULT_HOST,
    DEFAULT_PORT,
    check_host,
    require_viser,
    silent,
    started,
)

if TYPE_CHECKING:
    import viser


def serve(
    path: str | Path,
    *,
    protocol: str | None = None,
    rig: str | Path | None = None,
    host: str = DEFAULT_HOST,
    port: int = DEFAULT_PORT,
    block: bool = True,
) -> viser.ViserServer:
    """Serve a page that shows a library, a run or a release.

    Args:
        path: What to show.
        protocol: Whose verdicts; when omitted a release's default, else `paper-1` or the only one.
        rig: Whose arms, where a run has solutions of several rigs; see `Run.rig` when omitted.
        host: Address to listen on; `0.0.0.0` shows it to everyone who reaches this machine.
        port: Where to listen; the next free port when it is taken (`server.get_port()`).
        block: Serve until interrupted, then stop. Otherwise return at once; call `server.stop()`.

    Raises:
        PathNotFound: `path` does not exist.
        NotUsable: There is nothing to show, no saying whose verdicts are meant, or `host` is no
            address of this machine.
        UnknownName: There are no verdicts of the protocol, or no arms of the rig.
        MissingExtra: viser is not installed.
    """
    server = serve_source(open_browsable(path, protocol, rig), host=host, port=port)
    if block:
        wait_until_interrupted(server)
    return server


def serve_source(
    source: Browsable, *, host: str = DEFAULT_HOST, port: int = DEFAULT_PORT
) -> viser.ViserServer:
    """Serve what is open already, and return at once; see `serve`."""
    require_viser()
    check_host(host)
    catalog = Catalog(source)
    if not catalog.object_ids:
        raise NotUsable(f"{source.path} holds no objects, so there is nothing to show")
    catalog.preload()
    server = started(host, port)
    server.gui.configure_theme(control_width="large", show_logo=False, show_share_button=False)
    server.gui.main_panel.dock_right()  # beside the picture: floating, it hides a part of it

    def connected(client: viser.ClientHandle) -> None:
        camera = PageCamera(client)
        pages[client.client_id] = Page(client.gui, client.scene, catalog, camera.show)

    def gone(client: viser.ClientHandle) -> None:
        page = pages.pop(client.client_id, None)
        if page is not None:
            page.close()

    pages: dict[int, Page] = {}
    server.on_client_connect(connected)
    server.on_client_disconnect(gone)
    return server


def wait_until_interrupted(server: viser.ViserServer) -> None:
    """Sleep until Ctrl-C, then stop the server."""
    import time

    try:
        while True:
            time.sleep(3600)
    except KeyboardInterrupt:
        pass
    finally:
        with silent():
            server.stop()
