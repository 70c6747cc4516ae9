"""Servers that are not ours, for what clients say of them."""

import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def answering(reply: bytes, end: bytes = b"") -> Iterator[str]:
    """Address of one that reads a request, up to these bytes, answers with ``reply`` whatever it was, and hangs up."""
    with socket.create_server(("127.0.0.1", 0)) as server:

        def answer() -> None:
            one, _ = server.accept()
            with one:
                asked = one.recv(65536)
                while not asked.endswith(end):
                    asked += one.recv(65536)
                one.sendall(reply)

        threading.Thread(target=answer, daemon=True).start()
        yield "127.0.0.1:{1}".format(*server.getsockname())
