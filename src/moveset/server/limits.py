"""What a client may ask of the server. One place, so that the documentation can say it all."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Limits:
    """Limits of one server.

    Args:
        prompt: characters of a prompt.
        seconds: of a clip, all its prompts together where they are given.
        streams: streams at a time.
        connections: WebSockets at a time.
        message: bytes of a WebSocket message to the server.
        messages_per_second: of one WebSocket; faster ones are read more slowly.
        bad_messages: malformed messages after which a WebSocket is closed.
        idle: seconds without any message after which a WebSocket is closed.
        buffer: least and most seconds that a stream may be made ahead of what was acknowledged.
        jobs: clips waiting, in work, or being written.
        kept_jobs: finished jobs that are remembered.
        kept_seconds: for how long.
        kept_bytes: bytes of their results together.
        exports: files waiting to be written or in work; pictures and films count apart.
        export: bytes of packets to be exported.
        picture_seconds: of a motion to be drawn (mp4, gif, png).
        frames: of a file to be written, after resampling.
        body: bytes of any other request.
        sockets: TCP connections at a time, whatever they are for.
        patience: seconds that a new TCP connection has to send a request, and any has to send one that it began.
        pace: bytes a second, patience aside, that what is sent with a request must come with on average.
        stopping: seconds that work in progress has when the server stops.
    """

    prompt: int = 512
    prompts: int = 8
    variants: int = 8
    seconds: float = 60.0
    streams: int = 16
    connections: int = 64
    message: int = 8192
    messages_per_second: float = 200.0
    bad_messages: int = 100
    idle: float = 120.0
    buffer: tuple[float, float] = (0.5, 10.0)
    jobs: int = 32
    kept_jobs: int = 32
    kept_seconds: float = 600.0
    kept_bytes: int = 64 * 2**20
    exports: int = 8
    export: int = 16 * 2**20
    picture_seconds: float = 120.0
    frames: int = 100_000
    body: int = 64 * 2**10
    sockets: int = 256
    patience: float = 15.0
    pace: int = 10_000
    stopping: float = 10.0

    def public(self) -> dict[str, object]:
        names = (
            "prompt", "prompts", "variants", "seconds", "streams", "message", "messages_per_second", "idle", "buffer",
            "export", "picture_seconds", "frames",
        )  # fmt: skip
        return {name: getattr(self, name) for name in names}
