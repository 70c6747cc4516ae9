"""Features and latents that are kept are of the clips that they are used for, and are written whole or not at all."""

import errno
import os
import shutil

import numpy as np
import pytest
import torch

from moveset.data import feature_store
from moveset.data.bandai_captions import bandai_captions
from moveset.data.corpus import Corpus, CorpusWriter
from moveset.data.dataset import CorpusDataset, FolderDataset, open_for_training
from moveset.data.feature_store import FeatureStore
from moveset.data.humanml3d import HUMANML3D, KIT
from moveset.data.latents import LatentSet
from moveset.errors import InputError, MovesetError
from moveset.motion.features import get_codec
from moveset.motion.retarget import retarget
from tests.synthetic import TakeEntry, add_take, synthetic_motion
from tests.training.hml_folder import write_folder

NATIVE = get_codec("native")


class Still:
    """An encoder that says nothing."""

    def encode(self, x_BFD, lengths_B):
        return torch.randn(len(x_BFD), 2, 3), torch.zeros(len(x_BFD), 2, 3)


def corpus(path, seed=0, frames=(40, 52, 48), splits=("train", "train", "val"), said=4):
    """Takes of so many frames."""
    writer = CorpusWriter()
    for k, (count, split) in enumerate(zip(frames, splits, strict=True)):
        add_take(writer,
            TakeEntry(
                name=f"{k}", take=f"{k}", source="s", content="walk", style=None, split=split, subject="s",
                captions=bandai_captions("walk")[:said], motion=synthetic_motion("walk", count, seed=seed + k),
            )
        )  # fmt: skip
    return CorpusDataset(Corpus.open(writer.write(path)))


def test_features_of_another_corpus_are_refused_though_it_has_as_many_clips(tmp_path):
    folder = tmp_path / "cache" / "store"
    FeatureStore.of(corpus(tmp_path / "a"), NATIVE, folder)
    with pytest.raises(InputError, match=r"store was made from other clips; delete it .*latents-\*"):
        FeatureStore.of(corpus(tmp_path / "b", seed=9), NATIVE, folder)
    with pytest.raises(InputError, match="other clips"):  # statistics are of the training split
        FeatureStore.of(corpus(tmp_path / "c", splits=("val", "train", "val")), NATIVE, folder)
    # The same motions in other words are the same to it.
    FeatureStore.of(corpus(tmp_path / "d", said=2), NATIVE, folder)


@pytest.mark.parametrize("changed", ["Std.npy", "new_joint_vecs/000001.npy", "texts/000001.txt", None])
def test_features_of_a_folder_that_has_changed_are_refused(tmp_path, changed):
    folder, store = write_folder(tmp_path / "data"), tmp_path / "cache" / "store"
    hml = get_codec("hml")
    made = FeatureStore.of(open_for_training(folder), hml, store)
    assert [clip.frames for clip in made.clips[:2]] == [120, 60]
    if changed is None:
        moved = folder.rename(tmp_path / "moved")
        FeatureStore.of(open_for_training(moved), hml, store)
        return
    if changed.endswith(".npy"):
        np.save(folder / changed, np.load(folder / changed) * 2)
        os.utime(folder / changed, (1, 1))
    else:  # the second part of the motion is another
        (folder / changed).write_text((folder / changed).read_text().replace("#4.0", "#5.0"))
    with pytest.raises(InputError, match="other clips"):
        FeatureStore.of(open_for_training(folder), hml, store)


@pytest.mark.parametrize("layout", [HUMANML3D, KIT])
def test_who_turns_left_turns_left_in_every_store(tmp_path, layout):
    """KIT-ML's axes are a mirror image of those of motions."""
    folder, codec = write_folder(tmp_path / "data", layout), get_codec(layout.codec)
    for kind in ("left", "right"):
        motion = retarget(synthetic_motion(f"walk-turn-{kind}", 120, seed=0), codec.skeleton).resampled(codec.fps)
        name = {"left": "000002", "right": "e"}[kind]
        np.save(folder / "new_joint_vecs" / f"{name}.npy", codec.encode(motion).numpy())
    opened = open_for_training(folder)
    for _ in range(2):  # made, and then opened
        store = FeatureStore.of(opened, codec, tmp_path / "store")
        turns = {opened.clip(k).group: float(store.sides[k, 2]) for k in range(len(store.clips))}
        assert (turns["000002"], turns["e"]) == (1.0, -1.0)


def test_latents_of_another_corpus_are_refused(tmp_path):
    one, other = corpus(tmp_path / "a"), corpus(tmp_path / "b", seed=9)
    stores = [FeatureStore.of(source, NATIVE, tmp_path / name) for source, name in ((one, "one"), (other, "other"))]
    path = tmp_path / "cache" / "latents-x-train.safetensors"
    path.parent.mkdir()
    made = LatentSet.of(one, "train", stores[0], Still(), path)
    assert torch.equal(LatentSet.of(one, "train", stores[0], Still(), path).mean, made.mean)
    with pytest.raises(InputError, match=r"latents-x-train.safetensors was made from other clips; delete"):
        LatentSet.of(other, "train", stores[1], Still(), path)


def test_what_a_killed_training_left_is_cleared_away(tmp_path):
    folder = tmp_path / "cache" / "store"
    left = [folder.with_name(f".store.{pid}") for pid in (os.getpid(), 1)]
    for one in left:
        one.mkdir(parents=True)
        (one / "raw").write_bytes(b"half")
    other = folder.with_name(".other.1")
    other.mkdir()
    store = FeatureStore.of(corpus(tmp_path / "a"), NATIVE, folder)
    assert len(store.clips) == 6
    assert not any(one.exists() for one in left)
    assert other.is_dir()


@pytest.mark.parametrize("name", ["raw", "features.npy"])
def test_a_full_disk_is_one_sentence(tmp_path, monkeypatch, name):
    class Full:
        def __init__(self, file):
            self.file = file

        def write(self, content):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

        def __enter__(self):
            return self

        def __exit__(self, *given):
            self.file.close()

    opened = open

    def opener(path, mode):
        file = opened(path, mode)
        return Full(file) if path.name == name else file

    monkeypatch.setattr(feature_store, "open", opener, raising=False)
    folder = tmp_path / "cache" / "store"
    with pytest.raises(MovesetError, match=r"store could not be written \(No space left on device\)"):
        FeatureStore.of(corpus(tmp_path / "a"), NATIVE, folder)
    assert [path.name for path in folder.parent.iterdir()] == [".lock"]


def test_features_are_stored_as_numpy_stores_them(tmp_path):
    source = corpus(tmp_path / "a")
    store = FeatureStore.of(source, NATIVE, tmp_path / "store")
    whole = np.concatenate(
        [store.normalizer.normalize(source.clip(k).features(NATIVE).float()).numpy() for k in range(6)]
    )
    np.testing.assert_allclose(np.load(tmp_path / "store" / "features.npy"), whole, atol=1e-6)
    np.save(tmp_path / "theirs.npy", np.load(tmp_path / "store" / "features.npy"))
    assert (tmp_path / "theirs.npy").read_bytes() == (tmp_path / "store" / "features.npy").read_bytes()


@pytest.mark.parametrize("splits", [("train", "train", "test"), ("val", "val", "test")])
def test_a_corpus_without_a_split_is_refused_at_once(tmp_path, splits):
    corpus(tmp_path / "a", splits=splits)
    with pytest.raises(InputError, match=f"no usable clip of the {'val' if 'train' in splits else 'train'} split"):
        open_for_training(tmp_path / "a")


def test_what_a_source_says_of_itself_is_said_again(tmp_path):
    write_folder(tmp_path / "data")
    one, again = open_for_training(tmp_path / "data"), open_for_training(tmp_path / "data")
    assert isinstance(one, FolderDataset)
    assert one.fingerprint == again.fingerprint
    corpus(tmp_path / "a")
    shutil.copy(tmp_path / "a", tmp_path / "b")
    assert (
        open_for_training(tmp_path / "a").fingerprint
        == open_for_training(tmp_path / "b").fingerprint
        != one.fingerprint
    )
