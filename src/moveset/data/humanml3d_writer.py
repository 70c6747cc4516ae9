"""A corpus as a HumanML3D or KIT-ML folder, for whatever reads those: ``data.humanml3d`` says what one holds."""

import math
import re
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from tqdm import tqdm

from moveset.data.corpus import Corpus
from moveset.data.dataset import Clip, CorpusDataset
from moveset.data.humanml3d import HUMANML3D, Layout
from moveset.data.splits import Split
from moveset.errors import InputError, MovesetError
from moveset.io.limits import make_folder, write_text
from moveset.motion.clip import Motion
from moveset.motion.features import Normalizer, get_codec
from moveset.motion.hml import HmlCodec
from moveset.motion.retarget import retarget

_BATCH = 64  # motions encoded at once
_SPLITS: tuple[Split, ...] = ("train", "val", "test")


def write_humanml3d(corpus: Corpus, folder: Path, layout: Layout = HUMANML3D, *, progress: bool = False) -> Path:
    """Write every clip of a corpus and its mirror image, by its split.

    Features are computed as the data sets' are, on their body; statistics are those of the training split. Words of
    sentences are tagged OTHER, for parts of speech are not known. Of a clip that shows one thing after another each
    part has its times.

    Args:
        folder: to write; it may not be there yet.
        layout: ``HUMANML3D``, or ``KIT``, whose skeleton, frame rate and units motions are brought to.

    Raises:
        InputError: the folder is there or cannot be made, or nothing is of the training split.
        MovesetError: the disk is full or not writable.
    """
    if folder.exists():
        raise InputError(f"{folder} is there already; give the name of a new folder")
    codec = get_codec(layout.codec)
    assert isinstance(codec, HmlCodec)
    dataset = CorpusDataset(corpus)
    if not dataset.split("train"):
        raise InputError("a corpus without a clip of the training split has no statistics; build it from more takes")
    make_folder(folder.parent)
    try:
        # Whole or not at all: half a data set reads as one.
        with TemporaryDirectory(prefix=f".{folder.name}.", dir=folder.parent) as place:
            _write_all(dataset, Path(place) / folder.name, codec, layout, progress)
            (Path(place) / folder.name).rename(folder)
    except OSError as error:
        reason = error.strerror or error
        raise MovesetError(f"cannot write {folder}: {reason}; make room or choose another place") from error
    return folder


def _write_all(dataset: CorpusDataset, folder: Path, codec: HmlCodec, layout: Layout, progress: bool) -> None:
    for part in ("new_joint_vecs", "new_joints", "texts"):
        (folder / part).mkdir(parents=True)
    names: dict[Split, list[str]] = {split: [] for split in _SPLITS}
    trained = []
    for split in _SPLITS:
        items = dataset.split(split)
        bar = tqdm(range(0, len(items), _BATCH), desc=f"{split} of {folder.name}", disable=None if progress else True)
        for start in bar:
            clips = {item: dataset.clip(item) for item in items[start : start + _BATCH]}
            motions = [_on(clip.motion(), codec) for clip in clips.values()]
            encoded = codec.encode_world([motion.joints for motion in motions])
            for (item, clip), rows in zip(clips.items(), encoded, strict=True):
                name = f"{'M' * (item % 2)}{item // 2:06d}"
                np.save(folder / "new_joint_vecs" / f"{name}.npy", rows.numpy())
                np.save(folder / "new_joints" / f"{name}.npy", (codec.joints(rows) / codec.convention.unit).numpy())
                _write(folder / "texts" / f"{name}.txt", _texts(clip, layout))
                names[split].append(name)
                trained += [rows] if split == "train" else []
    statistics = Normalizer.fit(trained, codec.groups)
    np.save(folder / "Mean.npy", statistics.mean.numpy())
    np.save(folder / "Std.npy", statistics.std.numpy())
    for split, listed in names.items():
        _write(folder / f"{split}.txt", listed)
    _write(folder / "all.txt", [name for listed in names.values() for name in listed])


def _on(motion: Motion, codec: HmlCodec) -> Motion:
    """The motion on a data set's skeleton, at its frame rate."""
    if motion.skeleton.joints != codec.skeleton.joints:
        motion = retarget(motion, codec.skeleton)
    return motion.resampled(codec.fps)


def _texts(clip: Clip, layout: Layout) -> list[str]:
    """Lines "caption#tokens#start#end": of the whole clip with times 0, then of its parts.

    A part's times are those of its rows by the readers' clock, which is not KIT-ML's frame rate.
    """
    lines = [_line(caption, 0.0, 0.0) for caption in clip.captions]
    start = 0
    for part in clip.parts:
        # The first row that is not before the next part's first frame.
        stop = math.ceil(part.stop / clip.fps * layout.fps - 1e-6)
        times = start / layout.text_fps, stop / layout.text_fps
        lines += [_line(caption, *times) for caption in part.captions]
        start = stop
    return lines


def _line(caption: str, start: float, stop: float) -> str:
    sentence = caption.replace("#", " ").strip()
    tokens = " ".join(f"{word}/OTHER" for word in re.findall(r"[a-z0-9']+", sentence.lower()))
    return f"{sentence}#{tokens}#{start:.2f}#{stop:.2f}"


def _write(path: Path, lines: Sequence[str]) -> None:
    write_text(path, "".join(f"{line}\n" for line in lines))
