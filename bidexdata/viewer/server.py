"""The server behind the page: where it listens, and that it starts and ends without a word."""

from __future__ import annotations

import contextlib
import io
import logging
import socket
import warnings
from typing import TYPE_CHECKING, Any

from bidexdata.errors import MissingExtra, NotUsable

if TYPE_CHECKING:
    import viser

DEFAULT_PORT = 8080
DEFAULT_HOST = "127.0.0.1"


def require_viser() -> Any:
    """The package that draws the page.

    Raises:
        MissingExtra: It is not installed.
    """
    try:
        import viser
    except ImportError as err:
        raise MissingExtra("viser", "view") from err
    return viser


def started(host: str, port: int) -> viser.ViserServer:
    """Start a server; it takes the next free port where one is taken (`get_port()`).

    Raises:
        MissingExtra: viser is not installed.
        NotUsable: `host` is no address of this machine.
    """
    viser = require_viser()
    check_host(host)
    # A window may be closed while something is on its way to it.
    warnings.filterwarnings("ignore", "Queued a .* on a closed connection", UserWarning)
    # A browser opens connections that it then does not use; the package would log each as an error.
    logging.getLogger("websockets.server").setLevel(logging.CRITICAL)
    with silent():
        return viser.ViserServer(host=host, port=port, label="bidexdata", verbose=False)


def check_host(host: str) -> None:
    """Refuse an address that this machine cannot listen on; the server would wait for ever.

    Raises:
        NotUsable: It is not one of this machine's.
    """
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(
            host, 0, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE
        )[0]
        with socket.socket(family, kind, protocol) as probe:
            probe.bind(address)
    except (OSError, UnicodeError) as err:
        raise NotUsable(
            f"--host {host!r} is no address of this machine ({err}); "
            f"take {DEFAULT_HOST}, or 0.0.0.0 for the whole network"
        ) from err


def free_port() -> int:
    """A port of this machine that nothing listens on now."""
    with socket.socket() as probe:
        probe.bind((DEFAULT_HOST, 0))
        return probe.getsockname()[1]


def silent() -> contextlib.AbstractContextManager[object]:
    """Keep the server's banners off standard output, which belongs to the command that called."""
    return contextlib.redirect_stdout(io.StringIO())
