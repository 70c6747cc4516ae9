"""What the server counts, for Prometheus."""

from prometheus_client import CollectorRegistry, Counter, Gauge, Histogram, generate_latest

from moveset.pipelines.stream_batch import Segment
from moveset.pipelines.text_to_motion import Generation

_SECONDS = (0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0)


class Metrics:
    """Counters of one server; each has a registry of its own, so that several may live in one process."""

    def __init__(self) -> None:
        r = self._registry = CollectorRegistry()
        self.streams = Gauge("moveset_streams", "Streams that are open.", registry=r)
        self.connections = Gauge("moveset_connections", "WebSockets that are open and were not refused.", registry=r)
        self.requests = Counter("moveset_requests", "Answered HTTP requests.", ["status"], registry=r)
        self.refused = Counter("moveset_refused", "Requests and messages that were refused.", ["code"], registry=r)
        self.segments = Counter("moveset_segments", "Segments made.", registry=r)
        self.clips = Counter("moveset_clips", "Clips made.", registry=r)
        self.frames = Counter("moveset_frames", "Frames made, in streams and clips.", registry=r)
        self.evaluations = Counter("moveset_network_evaluations", "Evaluations of denoisers.", registry=r)
        self.latency = Histogram(
            "moveset_segment_seconds", "Making a segment, its whole batch.", buckets=_SECONDS, registry=r
        )
        self.queue = Histogram(
            "moveset_segment_queue_seconds", "From being due to being begun.", buckets=_SECONDS, registry=r
        )
        self.batch = Histogram(
            "moveset_batch_streams", "Streams in a batched call.", buckets=(1, 2, 4, 8, 16, 32), registry=r
        )

    def segment(self, made: Segment, queue_ms: float) -> None:
        self.segments.inc()
        self.frames.inc(made.frames)
        self.evaluations.inc(made.network_evaluations)
        self.latency.observe(made.latency_ms / 1e3)
        self.queue.observe(max(queue_ms, 0.0) / 1e3)

    def clip(self, made: Generation) -> None:
        self.clips.inc()
        self.frames.inc(len(made.motion))
        self.evaluations.inc(made.network_evaluations)

    def text(self) -> bytes:
        """All of it, in Prometheus' text format."""
        return generate_latest(self._registry)
