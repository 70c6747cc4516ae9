"""Moving pictures: GIF by Pillow, MP4 (H.264) by the ffmpeg that imageio-ffmpeg brings."""

import os
import tempfile
from collections import deque
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path

from PIL import Image, ImageDraw

from moveset.errors import InputError, MovesetError
from moveset.io.limits import atomic_write
from moveset.io.render import INK, TRAIL, Painter, fitted, font, three_quarter_view
from moveset.motion.clip import Motion

MAX_SECONDS = 300.0
_VIDEO, _GIF = 480, 320
_COLOURS = 64
_COMMENT = 60_000  # bytes; ffmpeg is told it on its command line, where Linux allows 128 KB


def film_rate(fps: float, suffix: str) -> float:
    """Frames a second with which a motion of ``fps`` is shown: MP4 keeps 20 to 30, GIF 100/4 and 100/5.

    >>> film_rate(60.0, ".mp4"), film_rate(60.0, ".gif"), film_rate(25.0, ".gif")
    (30.0, 20.0, 25.0)
    """
    if suffix == ".gif":
        return fps if fps in (20.0, 25.0) else 20.0
    return fps if 20 <= fps <= 30 else 30.0


def write_mp4(motion: Motion, path: str | Path, *, caption: str = "", metadata: str = "") -> None:
    """Write an H.264 video, 480 x 480 pixels, at the rate that ``film_rate`` says.

    ``metadata`` (JSON) becomes the comment tag, if it has at most 60,000 bytes.

    Raises:
        InputError: longer than 300 s, or the path cannot be written to.
        MovesetError: ffmpeg failed.
    """
    from imageio_ffmpeg import write_frames

    motion = _filmed(motion, ".mp4")
    # One thread: with several the bytes depend on how many cores there are.
    options = ["-preset", "veryfast", "-crf", "23", "-threads", "1", "-movflags", "+faststart", "-fflags", "+bitexact"]
    options += ["-metadata", f"comment={comment}"] if (comment := _comment(metadata)) else []
    # ffmpeg wants a seekable file of its own with the right extension.
    with atomic_write(path) as file, tempfile.TemporaryDirectory() as folder:
        name = str(Path(folder, "motion.mp4"))
        writer = write_frames(
            name, (_VIDEO, _VIDEO), fps=motion.fps, codec="libx264", output_params=options, macro_block_size=2
        )
        try:
            writer.send(None)
            for picture in _pictures(motion, _VIDEO, caption):
                writer.send(picture.tobytes())
            writer.close()
            file.write(Path(name).read_bytes())
        except (OSError, RuntimeError) as error:
            raise MovesetError(f"ffmpeg could not write the video ({error}); try .gif instead") from error


def write_gif(motion: Motion, path: str | Path, *, caption: str = "", metadata: str = "") -> None:
    """Write a looping GIF, 320 x 320 pixels, in the motion's time: GIF counts hundredths of a second.

    ``metadata`` (JSON) becomes the comment, if it has at most 60,000 bytes.

    Raises:
        InputError: longer than 300 s, or the path cannot be written to.
    """
    motion = _filmed(motion, ".gif")
    # One palette for all frames: they show the same materials, light and floor.
    samples = [motion[k : k + 1] for k in {0, len(motion) // 2, len(motion) - 1}]
    swatch = Image.new("RGB", (_GIF * len(samples), _GIF))
    for k, sample in enumerate(samples):
        swatch.paste(next(_pictures(sample, _GIF, caption)), (_GIF * k, 0))
    swatch.paste(TRAIL, (0, 0, _GIF, 4))
    palette = swatch.quantize(_COLOURS, method=Image.Quantize.MEDIANCUT)
    indexed = (
        picture.quantize(palette=palette, dither=Image.Dither.NONE) for picture in _pictures(motion, _GIF, caption)
    )
    with atomic_write(path) as file:
        next(indexed).save(
            file,
            format="GIF",
            save_all=True,
            append_images=indexed,
            duration=round(1000 / motion.fps),
            loop=0,
            optimize=False,
            comment=_comment(metadata).encode(),
        )


def _comment(metadata: str) -> str:
    """Metadata that a film can hold: all or nothing, since half of it is no JSON."""
    return metadata if len(metadata.encode()) <= _COMMENT else ""


def _filmed(motion: Motion, suffix: str) -> Motion:
    """The motion at the rate of a film that is not too long."""
    if motion.seconds > MAX_SECONDS:
        raise InputError(
            f"a motion of {motion.seconds:.0f} s exceeds the {MAX_SECONDS:.0f} s that {suffix} files hold; "
            "save a slice of it, or write .bvh, .glb or .npz"
        )
    return motion.resampled(film_rate(motion.fps, suffix))


def _pictures(motion: Motion, size: int, caption: str) -> Iterator[Image.Image]:
    """Every frame with its caption, in order, drawn by a few threads a little ahead of the encoder."""
    painter = Painter(motion, three_quarter_view(motion, size, size, below=44))
    text = fitted(caption, 15, size - 84, lines=2)

    def draw(index: int) -> Image.Image:
        picture = painter.frame(index)
        pen = ImageDraw.Draw(picture)
        pen.multiline_text((12, size - 9), text, font=font(15), fill=INK, anchor="ld", spacing=2)
        pen.text((size - 12, size - 9), f"{index / motion.fps:.1f} s", font=font(15), fill=INK, anchor="rd")
        return picture

    workers = min(4, os.cpu_count() or 1)
    with ThreadPoolExecutor(workers) as pool:
        ahead: deque[Future[Image.Image]] = deque()
        for index in range(len(motion)):
            ahead.append(pool.submit(draw, index))
            if len(ahead) > 4 * workers:
                yield ahead.popleft().result()
        while ahead:
            yield ahead.popleft().result()
