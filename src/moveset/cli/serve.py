"""``moveset serve``: the studio page and the server that engines talk to."""

import sys
import threading
from typing import TYPE_CHECKING, Annotated

import tyro

from moveset.errors import InputError

if TYPE_CHECKING:
    from moveset.server.service import Options

_LOOPBACK = ("127.0.0.1", "localhost", "::1")
_EVERYWHERE = {"0.0.0.0": "127.0.0.1", "::": "::1"}  # no addresses to browsers, and what this machine has for them


def serve(
    *,
    host: Annotated[str, tyro.conf.arg(metavar="HOST")] = "127.0.0.1",
    port: Annotated[int, tyro.conf.arg(metavar="N")] = 8765,
    model: Annotated[tyro.conf.UseAppendAction[tuple[str, ...]], tyro.conf.arg(metavar="NAME")] = (),
    device: Annotated[str, tyro.conf.arg(metavar="NAME")] = "auto",
    open: bool = True,
    allow_origin: Annotated[tyro.conf.UseAppendAction[tuple[str, ...]], tyro.conf.arg(metavar="URL")] = (),
    streams: Annotated[int, tyro.conf.arg(metavar="N")] = 16,
    idle: Annotated[float, tyro.conf.arg(metavar="S")] = 120.0,
) -> int:
    """Open the studio in a browser, and serve clips by HTTP and streams by WebSocket.

    Args:
        host: Address to listen on; by default only this machine can connect.
        port: Port to listen on; 0 takes any that is free.
        model: A shipped model or a model folder; several times for several. Without it all shipped models.
        device: auto, cpu, cuda or mps.
        open: Open the page in a browser.
        allow_origin: Another site whose pages may use this server, such as https://example.org, or null, file:// or
            app://name for pages of programs; may be repeated.
        streams: Most streams at a time.
        idle: Seconds without a message after which a stream is closed.
    """
    if not 0 <= port <= 65_535:
        raise InputError(f"port {port} is not in 0 to 65535; leave it out for 8765")
    if not 1 <= streams <= 1000:
        raise InputError(f"{streams} streams are not in 1 to 1000; leave it out for 16")
    if not 1.0 <= idle <= 86_400.0:
        raise InputError(f"{idle:g} seconds are not in 1 to 86400; leave it out for 120")
    _require()
    from moveset.server.app import create_app
    from moveset.server.run import listen, make_server

    app = create_app(_options(host, model, device, allow_origin, streams, idle))
    socket = listen(host, port)
    address, port = socket.getsockname()[:2]

    def opened() -> None:
        print(f"moveset serves at {_url(host, port)} (Ctrl-C stops it)", flush=True)
        if host not in _LOOPBACK:
            print(f"moveset: warning: whoever can reach {host} can use this server", file=sys.stderr)
        if open:
            import webbrowser

            # A browser of the terminal is waited for, and the server is not to wait.
            page = _url(_EVERYWHERE.get(address, host), port)
            threading.Thread(target=webbrowser.open, args=(page,), daemon=True).start()

    make_server(app, opened=opened).run([socket])
    return 0


def _url(host: str, port: int) -> str:
    return f"http://{f'[{host}]' if ':' in host else host}:{port}/"


def _require() -> None:
    """Raises InputError where the server's libraries are missing."""
    try:
        import fastapi  # noqa: F401
        import prometheus_client  # noqa: F401
        import uvicorn  # noqa: F401
        import websockets  # noqa: F401
    except ImportError as error:
        raise InputError(f"{error.name} is not installed; run: pip install 'moveset[serve]'") from None


def _options(
    host: str, models: tuple[str, ...], device: str, origins: tuple[str, ...], streams: int, idle: float
) -> "Options":
    from moveset.server.limits import Limits
    from moveset.server.service import Options

    room = Limits()
    limits = Limits(
        streams=streams,
        idle=idle,
        connections=max(room.connections, 2 * streams),
        sockets=max(room.sockets, 4 * streams),
    )
    hosts = ("127.0.0.1", "localhost", "[::1]") if host in _LOOPBACK else None
    return Options(models, device, limits, origins, hosts)
