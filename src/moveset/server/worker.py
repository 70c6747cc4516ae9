"""The one thread that generates: streams that run out first, and clips in between.

A turn does what clients asked of their streams, makes the next segment of those that are due (all of one model and one
setting by one batched call), and then one clip of one job. Streams are also served between any two clips of a job; as
long as one of them is about to run out, up to ``_RUSH`` batches in a row. Jobs take turns, one variant at a time. So
nobody waits for more than a clip and a few batches, whatever the others ask for.
"""

import logging
import threading
import time
from collections import deque
from collections.abc import Callable
from typing import Any

import torch

from moveset.errors import MovesetError
from moveset.io.packets import pack_packet, skeleton_json
from moveset.pipelines.stream_batch import StreamBatch
from moveset.server.catalog import Catalog
from moveset.server.failures import RequestError, busy, cancelled, stopping, told
from moveset.server.jobs import Job
from moveset.server.limits import Limits
from moveset.server.metrics import Metrics
from moveset.server.sessions import Message, Session

_log = logging.getLogger("moveset.server")
_RUSH = 4  # batches in a row before a clip gets its turn
_SOON = 0.5  # seconds before it runs out from which a stream goes before clips


class _Cancelled(Exception):
    """The job in work was given up."""


class Worker:
    """Generates. All methods but ``run`` may be called from any thread and return at once.

    Args:
        finished: told of every job whose clips are all made, failed or cancelled, with its error if any; called by the
            worker's thread.
    """

    def __init__(
        self,
        catalog: Catalog,
        limits: Limits,
        metrics: Metrics,
        finished: Callable[[Job, RequestError | None], None],
    ) -> None:
        self._catalog, self._limits, self._metrics, self._finished = catalog, limits, metrics, finished
        self.lock = threading.Lock()
        self._work = threading.Condition(self.lock)
        self._sessions: list[Session] = []
        self._jobs: deque[Job] = deque()
        self._current: Job | None = None
        self._stopping = False
        self.ready = False
        self._thread = threading.Thread(target=self.run, name="moveset-worker", daemon=True)

    @property
    def alive(self) -> bool:
        return self._thread.is_alive()

    def start(self) -> None:
        self._thread.start()

    def stop(self) -> list[Job]:
        """Take nothing more: streams end, the job in work goes on, those that have not begun are returned."""
        with self.lock:
            self._stopping = True
            waiting = [job for job in self._jobs if job is not self._current and not job.made]
            self._jobs = deque(job for job in self._jobs if job not in waiting)
            for session in self._sessions:
                session.over = True
            self._work.notify()
        return waiting

    def join(self, seconds: float) -> None:
        """Wait for the thread to end; after that long what is in work is given up, within one evaluation."""
        if self._thread.is_alive():
            self._thread.join(seconds)
        with self.lock:
            for job in self._jobs:
                job.cancelled = True
        if self._thread.is_alive():
            self._thread.join()

    def cancel(self, job: Job) -> bool:
        """Give a job up. Whether it was still in the line: one in work ends, as cancelled, after its clip."""
        with self.lock:
            job.cancelled = True
            if job in self._jobs and job is not self._current:
                self._jobs.remove(job)
                return True
            return False

    def position(self, job: Job) -> int:
        """Place in the line, from 0."""
        with self.lock:
            return self._jobs.index(job) if job in self._jobs else 0

    def submit(self, job: Job) -> None:
        """Take a job.

        Raises:
            RequestError: the line is full, or the server is stopping.
        """
        with self.lock:
            if self._stopping:
                raise stopping()
            if len(self._jobs) >= self._limits.jobs:
                raise busy("clips", self._limits.jobs)
            self._jobs.append(job)
            self._work.notify()

    def join_stream(self, session: Session) -> None:
        """Take a stream.

        Raises:
            RequestError: there are as many as there may be, or the server is stopping.
        """
        with self.lock:
            if self._stopping:
                raise stopping()
            if len(self._sessions) >= self._limits.streams:
                raise busy("streams", self._limits.streams)
            self._sessions.append(session)
            self._metrics.streams.set(len(self._sessions))
            self._work.notify()

    def leave(self, session: Session) -> None:
        with self.lock:
            session.over = True
            if session in self._sessions:
                self._sessions.remove(session)
            self._metrics.streams.set(len(self._sessions))

    def tell(self, change: Callable[[], Any]) -> None:
        with self.lock:
            change()
            self._work.notify()

    @property
    def load(self) -> dict[str, int]:
        with self.lock:
            return {"streams": len(self._sessions), "jobs": len(self._jobs)}

    @torch.inference_mode()
    def run(self) -> None:
        self._warm_up()
        while True:
            with self.lock:
                while not (self._stopping or self._jobs or any(s.waiting or s.due for s in self._sessions)):
                    self._work.wait()
                if self._stopping and not self._jobs:
                    return
            self._serve()
            self._clip()

    def _warm_up(self) -> None:
        """Read the default models and make something, so that the first client need not wait for it."""
        for make in (self._first_clip, self._first_segments):
            try:
                make()
            except Exception:
                # Whoever asks for this model is told why; the others must not wait for a thread that is gone.
                _log.exception("a model could not be warmed up")
        self.ready = True

    def _first_clip(self) -> None:
        if self._catalog.default["clip"] is not None:
            t2m = self._catalog.ready(self._catalog.clip(None))
            t2m("a person walks", seconds=t2m.bundle.config.min_frames / t2m.bundle.config.fps)

    def _first_segments(self) -> None:
        if self._catalog.default["stream"] is not None:
            bundle = self._catalog.stream(None)
            batch = self._catalog.batch(bundle, self._catalog.request(bundle, None, 0, None, None).settings)
            stream = batch.open(bundle.config.idle, 0)
            for _ in range(2):
                batch.step([stream])

    def _serve(self) -> None:
        """Streams: wishes first, then segments, until nobody is about to run out."""
        for batches in range(_RUSH):
            with self.lock:
                waiting = [session for session in self._sessions if session.waiting]
            for session in waiting:
                self._obey(session)
            with self.lock:
                due = sorted((s for s in self._sessions if s.due), key=lambda s: s.deadline)
                sessions = [session for session in due if session.batch is due[0].batch]
            if not due or (batches and due[0].deadline > time.monotonic() + _SOON):
                return
            self._advance(sessions)

    def _advance(self, sessions: list[Session]) -> None:
        batch = sessions[0].batch
        assert batch is not None
        begun = time.monotonic()
        with self.lock:
            for session in sessions:
                session.keep()
            streams = [session.stream.copy() for session in sessions if session.stream is not None]
        try:
            segments = batch.step(streams)
        except Exception as error:
            if len(sessions) > 1:  # one of them; the others must not suffer
                for session in sessions:
                    self._advance([session])
                return
            _log.exception("a segment could not be made")
            sessions[0].deliver([_broken(error), {"type": "stopped", "frames": sessions[0].sent, "reason": "failed"}])
            self.leave(sessions[0])
            return
        self._metrics.batch.observe(len(sessions))
        for session, stream, made in zip(sessions, streams, segments, strict=True):
            packet = pack_packet(
                made.motion, first_frame=made.first_frame, latency_ms=made.latency_ms, planted=made.planted
            )
            with self.lock:
                session.stream = stream
                since, session.due_since = session.due_since or begun, None
                session.sent = made.first_frame + made.frames
                session.unsent += 1
                if session.over:
                    continue
            queue_ms = (begun - since) * 1e3
            said = {
                "type": "segment",
                "segment": made.number,
                "first_frame": made.first_frame,
                "frames": made.frames,
                "prompt": made.prompt,
                "latency_ms": made.latency_ms,
                "network_evaluations": made.network_evaluations,
                "queue_ms": round(queue_ms, 3),
            }
            session.deliver([said, packet])
            self._metrics.segment(made, queue_ms)

    def _obey(self, session: Session) -> None:
        """Do what a client asked of its stream, one of each kind; a refused one does not stop the others."""
        with self.lock:
            begin, session.begin = session.begin, None
            asked, session.asked = session.asked, None
            wishes, session.wishes = session.wishes, {}
            unsaid, session.unsaid = session.unsaid, []
        for do, what in ((self._begin, begin), (self._change, wishes or None), (self._prompt, asked)):
            if what is None:
                continue
            try:
                do(session, what)
            except (RequestError, MovesetError) as error:
                refused = error if isinstance(error, RequestError) else told(error)
                self._refuse(session, refused.body()["error"], what is begin)
            except Exception as error:
                _log.exception("a wish could not be fulfilled")
                self._refuse(session, _broken(error), True)
        if unsaid and not session.over:
            # Said here, between two segments: all that was in work when it was asked for has gone out before.
            session.deliver([{"type": word, "frame": session.sent} for word in unsaid])

    def _refuse(self, session: Session, error: dict[str, str], fatal: bool) -> None:
        session.deliver([{"type": "error", **error}])
        if fatal:
            # There is no stream: the connection may start another.
            self.leave(session)
            session.deliver([{"type": "stopped", "frames": 0, "reason": "refused"}])

    def _begin(self, session: Session, begin: Any) -> None:
        bundle = self._catalog.stream(begin.model)
        request = self._catalog.request(bundle, begin.prompt, begin.seed, begin.steps, begin.guidance)
        batch = self._catalog.batch(bundle, request.settings)
        stream = batch.open(begin.prompt or bundle.config.idle, request.seed, request.settings.guidance)
        with self.lock:
            session.started(batch, stream)
        said = {
            "type": "started",
            "stream": session.number,
            "model": bundle.config.name,
            "seed": stream.seed,
            "fps": session.fps,
            "segment_frames": session.segment,
            "buffer": session.buffer,
            "commit": session.commit,
            "skeleton": skeleton_json(batch.codec.skeleton),
            **_settings(session),
        }
        session.deliver([said, _effect(session, begin.prompt or bundle.config.idle)])

    def _change(self, session: Session, wishes: dict[str, Any]) -> None:
        batch, stream = session.batch, session.stream
        if batch is None or stream is None:
            return
        steps = wishes.get("steps", batch.settings.steps)
        guidance = wishes.get("guidance", stream.guidance)
        settings = self._catalog.request(batch.bundle, None, stream.seed, steps, guidance).settings
        changed: StreamBatch = self._catalog.batch(batch.bundle, settings)
        with self.lock:
            session.batch, stream.guidance = changed, settings.guidance
        session.deliver([{"type": "set", "buffer": session.buffer, **_settings(session)}])

    def _prompt(self, session: Session, text: str) -> None:
        if session.batch is None or session.stream is None:
            return
        session.batch.prompt(session.stream, text)
        with self.lock:
            session.go_back()
        session.deliver([_effect(session, text)])

    def _clip(self) -> None:
        with self.lock:
            job = self._current = self._jobs[0] if self._jobs else None
        if job is None:
            return
        try:
            self._make(job)
            error = None
        except _Cancelled:
            error = cancelled()
        except MovesetError as problem:
            error = told(problem)
        except Exception as problem:
            _log.exception("a clip could not be made")
            error = RequestError(
                500, "internal", f"{type(problem).__name__} while a clip was made; see the server's log"
            )
        over = error is not None or len(job.made) == len(job.order.requests)
        with self.lock:
            self._current = None
            if job in self._jobs:
                self._jobs.remove(job)
                if not over:
                    self._jobs.append(job)
        if over:
            self._finished(job, error)

    def _make(self, job: Job) -> None:
        order, made = job.order, len(job.made)
        share = 1.0 / len(order.requests)

        def between(done: float) -> None:
            job.progress = (made + done) * share
            if job.cancelled:
                raise _Cancelled
            self._serve()

        if job.cancelled:
            raise _Cancelled
        job.state = "running"
        t2m = self._catalog.ready(order.t2m)
        job.made += t2m.generate([order.requests[made]], order.method, between=between)
        self._metrics.clip(job.made[-1])


def _broken(error: Exception) -> dict[str, str]:
    return {"type": "error", "code": "internal", "message": f"{type(error).__name__} in the server; see its log"}


def _settings(session: Session) -> dict[str, Any]:
    assert session.batch is not None
    assert session.stream is not None
    return {"steps": session.batch.settings.steps, "guidance": session.stream.guidance}


def _effect(session: Session, text: str) -> Message:
    """What a client is told of its new prompt, which begins now."""
    assert session.batch is not None
    stream, n = session.stream, session.segment
    assert stream is not None
    begins = [max(start, stream.line.origin) * n for start in stream.line.starts]
    return {
        "type": "prompt",
        "text": text,
        "takes_effect_at": begins[0],
        "stages": [{"text": said, "takes_effect_at": at} for said, at in zip(stream.line.prompts, begins, strict=True)],
        "warnings": list(session.batch.warnings(stream)),
    }
