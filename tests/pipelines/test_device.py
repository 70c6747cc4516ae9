"""With how many threads networks are called, whatever the program around has set."""

import threading

import pytest
import torch
from torch.nn.modules.module import register_module_forward_pre_hook

from moveset.pipelines.model_config import StreamConfig
from moveset.pipelines.model_folder import ModelFolder
from moveset.pipelines.motion_stream import MotionStream
from moveset.pipelines.stream_batch import StreamBatch
from moveset.pipelines.stream_settings import check_stream
from moveset.pipelines.text_to_motion import TextToMotion


@pytest.fixture
def folders(tiny_clips, tiny_streams):
    return {"clips": tiny_clips, "streams": tiny_streams}


def clips(folders, batch=1):
    made = TextToMotion.from_pretrained(folders["clips"], device="cpu")("a person walks", seconds=2, num=2, batch=batch)
    return [motion.root for motion in made.motions]


def stream(folders, buffer=0):
    made = MotionStream.from_pretrained(folders["streams"], "a person walks", buffer=buffer, device="cpu")
    made.prompt("a person bows")
    return [next(made).motion.root for _ in range(3)]


def group(folders):
    bundle = ModelFolder.open(folders["streams"], StreamConfig)
    lanes = StreamBatch(bundle, check_stream(bundle.config, network="pcm-1").settings, device="cpu")
    lane = lanes.open("a person walks", 0)
    lanes.prompt(lane, "a person bows")
    return [lanes.step([lane])[0].motion.root]


def called(make, folders, monkeypatch, threads):
    """What is made, and with how many threads networks were called, where torch has some number of them."""
    seen = set()
    before = torch.get_num_threads()
    # A stream of the test before may still be filling its buffer.
    others = {thread.ident for thread in threading.enumerate()} - {threading.get_ident()}
    monkeypatch.delenv("OMP_NUM_THREADS", raising=False)

    def note(*_):
        if threading.get_ident() not in others:
            seen.add(torch.get_num_threads())

    handle = register_module_forward_pre_hook(note)
    torch.set_num_threads(threads)
    try:
        made = make(folders)
        assert torch.get_num_threads() == threads
    finally:
        handle.remove()
        torch.set_num_threads(before)
    return made, seen


@pytest.mark.parametrize("make", [clips, stream, lambda folders: stream(folders, buffer=2), group])
def test_one_clip_or_segment_at_a_time_is_made_by_one_thread(make, folders, monkeypatch):
    alone, one = called(make, folders, monkeypatch, 1)
    among, two = called(make, folders, monkeypatch, 2)
    assert one == two == {1}
    assert all(torch.equal(a, b) for a, b in zip(alone, among, strict=True))


def test_batches_and_whoever_says_so_have_more(folders, monkeypatch):
    assert called(lambda folders: clips(folders, batch=2), folders, monkeypatch, 2)[1] == {2}
    make = lambda folders: monkeypatch.setenv("OMP_NUM_THREADS", "2") or clips(folders)  # noqa: E731
    assert called(make, folders, monkeypatch, 2)[1] == {2}
