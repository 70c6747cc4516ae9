"""GIF and MP4: the right number of frames at the right times, a body in every one."""

import os

import numpy as np
import pytest
import torch
from imageio_ffmpeg import count_frames_and_secs, read_frames
from PIL import Image

from moveset.errors import InputError, MovesetError
from moveset.io import video
from moveset.io.video import write_gif, write_mp4
from moveset.motion import rotations
from moveset.motion.clip import Motion
from tests.motions import gait


def oranges(pixels):
    return (pixels[..., 0].astype(int) - pixels[..., 2] > 60).sum()


@pytest.mark.parametrize(("fps", "kept"), [(20.0, 20.0), (24.0, 24.0), (30.0, 30.0), (60.0, 30.0), (12.5, 30.0)])
def test_mp4_lasts_as_long_as_the_motion(fps, kept, tmp_path):
    motion = gait(20, fps=fps)
    write_mp4(motion, tmp_path / "a.mp4", caption="a person walks")
    frames, seconds = count_frames_and_secs(tmp_path / "a.mp4")
    assert frames == len(motion.resampled(kept))
    assert seconds == pytest.approx(frames / kept, abs=0.02)


def test_mp4_is_h264_that_plays_everywhere_and_shows_the_body(tmp_path):
    write_mp4(gait(12), tmp_path / "a.mp4", caption="a person walks", metadata='{"seed": 7}')
    frames = read_frames(tmp_path / "a.mp4")
    facts = next(frames)
    assert (facts["codec"], facts["pix_fmt"].split("(")[0], facts["size"]) == ("h264", "yuv420p", (480, 480))
    pictures = [np.frombuffer(frame, np.uint8).reshape(480, 480, 3) for frame in frames]
    assert len(pictures) == 12
    assert all(oranges(picture) > 500 for picture in pictures)
    assert np.abs(pictures[0].astype(int) - pictures[6]).mean() > 0.5
    data = (tmp_path / "a.mp4").read_bytes()
    assert b'{"seed": 7}' in data
    assert data.index(b"moov") < data.index(b"mdat"), "players on the web can begin at once"


@pytest.mark.parametrize(("fps", "kept"), [(20.0, 20.0), (25.0, 25.0), (30.0, 20.0)])
def test_gif_lasts_as_long_as_the_motion(fps, kept, tmp_path):
    motion = gait(20, fps=fps)
    write_gif(motion, tmp_path / "a.gif", caption="a person walks", metadata='{"seed": 7}')
    with Image.open(tmp_path / "a.gif") as gif:
        assert gif.n_frames == len(motion.resampled(kept))
        assert gif.info["loop"] == 0
        assert gif.info["comment"] == b'{"seed": 7}'
        for frame in range(gif.n_frames):
            gif.seek(frame)
            assert gif.info["duration"] == 1000 / kept
            assert oranges(np.asarray(gif.convert("RGB"))) > 200


def test_a_still_motion_keeps_its_time(tmp_path):
    """Equal frames may be merged, but their time must not be lost."""
    still = Motion(rotations.identity(10, 22), torch.tensor([0.0, 0.97, 0.0]).expand(10, 3).clone())
    write_gif(still, tmp_path / "a.gif")
    with Image.open(tmp_path / "a.gif") as gif:
        total = 0
        for frame in range(gif.n_frames):
            gif.seek(frame)
            total += gif.info["duration"]
    assert total == 500


def test_one_frame_makes_a_film(tmp_path):
    for write, name in ((write_mp4, "a.mp4"), (write_gif, "a.gif")):
        write(gait(1), tmp_path / name)
        assert (tmp_path / name).stat().st_size > 1000


def test_metadata_that_a_film_cannot_hold_is_left_out_whole(tmp_path):
    for write, name in ((write_mp4, "a.mp4"), (write_gif, "a.gif")):
        write(gait(2), tmp_path / name, metadata='{"prompt": "' + "ü" * 80_000 + '"}')
        assert b"prompt" not in (tmp_path / name).read_bytes()


@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="cores cannot be taken away from a process here")
@pytest.mark.skipif((os.cpu_count() or 1) < 2, reason="needs two cores")
def test_a_film_does_not_depend_on_the_number_of_cores(tmp_path):
    cores = os.sched_getaffinity(0)
    write_mp4(gait(30), tmp_path / "all.mp4")
    try:
        os.sched_setaffinity(0, {min(cores)})
        write_mp4(gait(30), tmp_path / "one.mp4")
    finally:
        os.sched_setaffinity(0, cores)
    assert (tmp_path / "all.mp4").read_bytes() == (tmp_path / "one.mp4").read_bytes()


def test_very_long_motions_are_refused(tmp_path):
    long = Motion(rotations.identity(7000, 22), torch.zeros(7000, 3))
    for write, name in ((write_mp4, "a.mp4"), (write_gif, "a.gif")):
        with pytest.raises(InputError, match=r"350 s exceeds the 300 s"):
            write(long, tmp_path / name)
    assert list(tmp_path.iterdir()) == []


def test_a_failing_encoder_leaves_nothing(tmp_path, monkeypatch):
    def broken(*_):
        raise OSError("no space left")

    monkeypatch.setattr(video, "_pictures", broken)
    with pytest.raises(MovesetError, match="no space left"):
        write_mp4(gait(3), tmp_path / "a.mp4")
    assert list(tmp_path.iterdir()) == []
