"""What the routes share: the models, the worker, the jobs, and how all of it ends."""

import asyncio
import itertools
import secrets
from collections.abc import Callable, Coroutine
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

from moveset import __version__
from moveset.errors import InputError, MovesetError
from moveset.io.packets import skeleton_json, unpack_packets
from moveset.pipelines.postprocess import Postprocess
from moveset.pipelines.request import check_request
from moveset.server import files
from moveset.server.catalog import Catalog
from moveset.server.failures import RequestError, busy, cancelled, stopping, told
from moveset.server.jobs import Answer, Job, JobBook, Order
from moveset.server.limits import Limits
from moveset.server.metrics import Metrics
from moveset.server.origins import as_sent
from moveset.server.protocol import GenerateBody
from moveset.server.worker import Worker
from moveset.server.writer import Writer


@dataclass(frozen=True)
class Options:
    """How a server is set up.

    Args:
        models: names of shipped models, or folders; by default everything that is shipped.
        origins: other sites whose pages may use this server, such as "https://example.org".
        hosts: names under which the server may be addressed; None allows any.

    Raises:
        InputError: an origin that no browser sends.
    """

    models: tuple[str | Path, ...] = ()
    device: str = "auto"
    limits: Limits = field(default_factory=Limits)
    origins: tuple[str, ...] = ()
    hosts: tuple[str, ...] | None = ("127.0.0.1", "localhost", "[::1]")

    def __post_init__(self) -> None:
        object.__setattr__(self, "origins", tuple(map(as_sent, self.origins)))


class Service:
    """One server's state; made and used on its event loop.

    Raises:
        InputError: no such model or device.
    """

    def __init__(self, options: Options) -> None:
        self.options, self.limits = options, options.limits
        self.metrics = Metrics()
        self.catalog = Catalog(options.models, options.device)
        self.worker = Worker(self.catalog, self.limits, self.metrics, self._made)
        self.book = JobBook(self.limits, self.worker.position)
        self.stopping = False
        self.connections = 0
        self.farewells: set[Callable[[], Coroutine[Any, Any, None]]] = set()
        self.stream_numbers = itertools.count(1)
        # A film takes as long to draw as many clips to make: what is written in a moment does not wait for it.
        self.writer, self.drawer = Writer("moveset-writer"), Writer("moveset-drawer")
        self._answers: set[asyncio.Task[None]] = set()

    def start(self) -> None:
        """Begin, on the running event loop."""
        self._loop = asyncio.get_running_loop()
        self.worker.start()

    async def stop(self) -> None:
        """End: streams are told so, waiting jobs are cancelled, and work in progress is given a little time."""
        if self.stopping:
            return
        self.stopping = True
        for job in self.worker.stop():
            job.end("cancelled", error=stopping())
        await asyncio.gather(*(farewell() for farewell in list(self.farewells)), return_exceptions=True)
        await asyncio.to_thread(self.worker.join, self.limits.stopping)
        if self._answers:
            await asyncio.wait(self._answers, timeout=self.limits.stopping)
        for job in self.book.unfinished():
            job.end("cancelled", error=stopping())
        self.writer.stop()
        self.drawer.stop()

    def health(self) -> dict[str, Any]:
        return {
            "status": "stopping" if self.stopping else "ok" if self.worker.alive else "failed",
            "ready": self.worker.ready,
            "version": __version__,
            **self.worker.load,
        }

    def models(self) -> dict[str, Any]:
        """What there is to choose from."""
        return {
            "models": self.catalog.describe(),
            "default": self.catalog.default,
            "limits": self.limits.public(),
            "formats": ["json", *files.FORMATS],
            "skeleton": skeleton_json(),
        }

    def order(self, body: GenerateBody) -> Order:
        """A checked order.

        Raises:
            RequestError: no such model.
            InputError: anything out of range.
        """
        t2m = self.catalog.clip(body.model)
        config, limits = t2m.bundle.config, self.limits
        given = sum(prompt.seconds or 0.0 for prompt in body.prompts)
        if given > limits.seconds:
            raise InputError(f"{given:g} s in all are more than the limit of {limits.seconds:g} s; make several clips")
        if body.format == "json":
            if body.skeleton is not None:
                raise InputError("JSON holds frames of the server's own skeleton; leave skeleton out or ask for a file")
        else:
            files.check_format(body.format)
            if body.num != 1:
                raise InputError(f"{body.num} variants do not go into one file; ask for one, or for JSON")
        longest = sum(prompt.seconds or config.max_frames / config.fps for prompt in body.prompts)
        files.check_length(longest, body.fps or config.fps, body.format, limits)
        texts = [prompt.text for prompt in body.prompts]
        seed = secrets.randbelow(2**31) if body.seed is None else body.seed
        seconds: list[Any] = [prompt.seconds for prompt in body.prompts]  # some may be left to the text
        return Order(
            t2m,
            check_request(config, texts, seconds, seed, body.num),
            self.catalog.method(t2m, body.steps, body.guidance),
            body.format,
            Postprocess(fps=body.fps, skeleton=body.skeleton, in_place=body.in_place, loop=body.loop),
        )

    def submit(self, order: Order) -> Job:
        """An order on its way.

        Raises:
            RequestError: too much is waiting, or the server is stopping.
        """
        # Not only the worker's line: answers that wait to be written hold their motions, too.
        if len(self.book.unfinished()) >= self.limits.jobs:
            raise busy("clips", self.limits.jobs)
        job = Job(order)
        self.worker.submit(job)
        self.book.add(job)
        return job

    def cancel(self, job: Job) -> None:
        if self.worker.cancel(job):
            job.end("cancelled", error=cancelled())

    async def export(self, data: bytes, format: str, finish: Postprocess, title: str) -> Answer:
        """Packets as a file.

        Raises:
            FormatError: no whole packets.
            InputError: an unknown format, or a motion that cannot be finished or written like this.
            RequestError: too much is waiting.
        """
        files.check_format(format)
        if self.stopping:
            raise stopping()
        writer = self._writer(format)
        if writer.writing >= self.limits.exports:
            raise busy("files", self.limits.exports)
        return await writer.write(partial(self._exported, data, format, finish, title))

    def _exported(self, data: bytes, format: str, finish: Postprocess, title: str) -> Answer:
        take = unpack_packets(data, max_bytes=self.limits.export, max_frames=self.limits.frames)
        files.check_length(take.motion.seconds, finish.fps or take.motion.fps, format, self.limits)
        notes = {"generator": f"moveset {__version__}", **({"prompt": title} if title else {})}
        return files.write_file(take.motion, format, finish, notes)

    def _writer(self, format: str) -> Writer:
        return self.drawer if format in files.PICTURES else self.writer

    def _made(self, job: Job, error: RequestError | None) -> None:
        """Called by the worker."""
        self._loop.call_soon_threadsafe(self._answer, job, error)

    def _answer(self, job: Job, error: RequestError | None) -> None:
        if error is not None:
            job.end("cancelled" if error.code == "cancelled" else "failed", error=error)
            return

        async def write() -> None:
            try:
                answer = await self._writer(job.order.format).write(partial(_written, job))
                # What draws films cannot be interrupted: who gave one up meanwhile is answered when it is drawn.
                if job.cancelled:
                    raise cancelled()
                job.end("done", answer)
            except RequestError as given_up:
                job.end("cancelled", error=given_up)
            except MovesetError as problem:
                job.end("failed", error=told(problem))
            except Exception as problem:
                job.end("failed", error=RequestError(500, "internal", f"{type(problem).__name__} while writing"))
                raise
            finally:
                self.book.forget()

        task = asyncio.create_task(write())
        self._answers.add(task)
        task.add_done_callback(self._answers.discard)


def _written(job: Job) -> Answer:
    """On a writer's thread, where a job may have waited: nothing is written for who gave it up."""
    if job.cancelled:
        raise cancelled()
    return files.answer(job)
