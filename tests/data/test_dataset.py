"""A corpus and a HumanML3D or KIT-ML folder look alike to what is trained and judged."""

from pathlib import Path
from threading import Thread

import numpy as np
import pytest
import torch

from moveset.cli.__main__ import main
from moveset.data import feature_store
from moveset.data.corpus import Corpus
from moveset.data.crops import CropSampler
from moveset.data.dataset import CorpusDataset, FolderDataset, open_for_training
from moveset.data.feature_store import FeatureStore
from moveset.data.latents import LatentSet
from moveset.data.weights import corpus_weights
from moveset.errors import InputError
from moveset.io.process import locked
from moveset.motion.features import get_codec
from moveset.training import checkpoint
from tests.synthetic import synthetic_corpus
from tests.training.hml_folder import write_folder


class Middle:
    """An encoder whose means say which frames it saw: the first and the last one."""

    def encode(self, x_BFD, lengths_B):
        last = x_BFD[torch.arange(len(x_BFD)), lengths_B - 1]
        return torch.stack((x_BFD[:, 0], last), dim=1), torch.zeros(len(x_BFD), 2, x_BFD.shape[2])


@pytest.fixture(scope="module")
def humanml3d(tmp_path_factory) -> Path:
    return write_folder(tmp_path_factory.mktemp("humanml3d") / "data")


@pytest.fixture(scope="module")
def corpus(tmp_path_factory) -> Path:
    return synthetic_corpus(tmp_path_factory.mktemp("corpus") / "corpus.safetensors", clips=24, seed=0)


def test_what_a_path_holds_is_found_out(humanml3d, corpus, tmp_path):
    assert isinstance(open_for_training(humanml3d), FolderDataset)
    assert isinstance(open_for_training(corpus), CorpusDataset)
    with pytest.raises(InputError, match="there is no corpus"):
        open_for_training(tmp_path / "nothing")
    with pytest.raises(InputError, match="new_joint_vecs"):
        open_for_training(tmp_path)


def test_items_of_a_folder_are_clips(humanml3d):
    source = open_for_training(humanml3d)
    assert [(item.name, item.start, item.stop) for item in source.items] == [
        ("000001", 0, 120), ("000001", 20, 80), ("000002", 0, 64), ("M000002", 0, 64), ("long", 0, 199), ("e", 0, 90),
        ("val1", 0, 80), ("val2", 0, 40), ("test1", 0, 70),
    ]  # fmt: skip
    assert (source.split("train"), source.split("val"), source.split("test")) == ((0, 1, 2, 3, 4, 5), (6, 7), (8,))
    assert source.clip(0).captions == ("the person walks forward.", "a person walks forward.")
    assert source.clip(1).captions == ("a person turns around.",)
    assert source.weights((0, 1, 5), power=0.5, composed_share=0.3).tolist() == [1.0, 1.0, 1.0]


def test_a_folder_is_stored_by_its_own_features_and_statistics(humanml3d, tmp_path):
    source = open_for_training(humanml3d)
    store = FeatureStore.of(source, get_codec("hml"), tmp_path / "store")
    mean, std = (np.load(humanml3d / f"{name}.npy") for name in ("Mean", "Std"))
    assert store.normalizer.mean.tolist() == mean.tolist()
    assert store.normalizer.std.tolist() == std.tolist()
    for clip, item in enumerate(source.items):
        whole = np.load(humanml3d / "new_joint_vecs" / f"{item.name}.npy")
        place = store.clips[clip]
        want = (whole[item.start : item.stop] - mean) / std
        assert np.array_equal(store.features[place.start : place.start + place.frames], want)
    assert not list(tmp_path.glob("store/raw*"))


def test_trainings_side_by_side_make_one_store(humanml3d, tmp_path, monkeypatch):
    source, codec, folder, made = open_for_training(humanml3d), get_codec("hml"), tmp_path / "cache" / "store", []
    make = feature_store._make
    monkeypatch.setattr(feature_store, "_make", lambda *given: made.append(given) or make(*given))
    both = [Thread(target=FeatureStore.of, args=(source, codec, folder)) for _ in range(2)]
    with locked(folder.parent):
        for one in both:
            one.start()
        both[0].join(0.3)
        assert all(one.is_alive() for one in both)
    for one in both:
        one.join(60)
    assert len(made) == 1
    assert len(FeatureStore.of(source, codec, folder).clips) == len(source)


def test_no_crop_is_longer_than_196_frames(humanml3d, tmp_path):
    source = open_for_training(humanml3d)
    store = FeatureStore.of(source, get_codec("hml"), tmp_path / "store")
    assert (store.whole(4).frames, store.whole(0).frames) == (196, 120)
    clips = source.split("train")
    sampler = CropSampler(store, clips, source.weights(clips, 0.25, 0.3), batch=8, seed=0)
    crops = [crop for step in range(64) for crop in sampler.crops(step)]
    long = [crop for crop in crops if crop.clip == 4]
    assert max(crop.frames for crop in long) == 196
    assert {crop.offset for crop in long if crop.frames == 196} == {0, 1, 2, 3}
    assert all(crop.offset + crop.frames <= store.clips[crop.clip].frames for crop in crops)
    shares = torch.bincount(torch.tensor([crop.clip for crop in crops]), minlength=6) / len(crops)
    assert (shares - 1 / 6).abs().max() < 0.06


def test_latents_of_a_folder_are_whole_clips_with_their_sentences(humanml3d, tmp_path):
    source = open_for_training(humanml3d)
    store = FeatureStore.of(source, get_codec("hml"), tmp_path / "store")
    latents = LatentSet.of(source, "train", store, Middle(), tmp_path / "train.safetensors")
    assert sorted(latents.clip.tolist()) == [0, 1, 2, 3, 4, 5]
    part = latents.clip.tolist().index(1)
    assert latents.captions(part) == ("a person turns around.",)
    assert latents.frames[part] == 60
    rows = torch.stack([torch.from_numpy(np.array(store.features[120 + at])) for at in (0, 59)])
    torch.testing.assert_close(latents.mean[part], rows, rtol=1e-3, atol=1e-3)
    val = LatentSet.of(source, "val", store, Middle(), tmp_path / "val.safetensors", windows=0)
    assert sorted(val.clip.tolist()) == [6, 7]


def test_a_corpus_is_numbered_with_its_mirror_images(corpus):
    opened = Corpus.open(corpus)
    source, records = CorpusDataset(opened), opened.indices("train")
    assert len(source) == 2 * len(opened)
    assert source.split("train") == tuple(k for record in records for k in (2 * record, 2 * record + 1))
    assert source.split("val", composed=False, mirrored=False) == tuple(
        2 * k for k in opened.indices("val", composed=False)
    )
    assert source.clip(2 * records[0] + 1).captions == opened.captions(records[0], mirrored=True)
    want = corpus_weights(opened, records, power=0.25, composed_share=0.3).repeat_interleave(2)
    assert torch.equal(source.weights(source.split("train"), 0.25, 0.3), want)
    composed = {2 * k for k in opened.indices("train", composed=True)}
    assert {k for k in source.split("train") if k % 2 == 0 and not source.clip(k).croppable} == composed != set()


def test_what_does_not_fit_is_said(humanml3d, corpus, tmp_path):
    source = open_for_training(humanml3d)
    with pytest.raises(InputError, match=r"'hml' features .* not 'native' ones.*codec=auto"):
        FeatureStore.of(source, get_codec("native"), tmp_path / "native")
    assert {path.name for path in tmp_path.iterdir()} <= {".lock"}  # nothing half made
    FeatureStore.of(source, get_codec("hml"), tmp_path / "store")
    with pytest.raises(InputError, match="made from other clips"):
        FeatureStore.of(CorpusDataset(Corpus.open(corpus)), get_codec("hml"), tmp_path / "store")
    with pytest.raises(InputError, match="no split 'dev'"):
        source.split("dev")


@pytest.mark.parametrize("missing", ["val.txt", "Mean.npy"])
def test_an_incomplete_folder_is_refused_at_once(tmp_path, missing):
    folder = write_folder(tmp_path / "data")
    (folder / missing).unlink()
    with pytest.raises(InputError, match=missing):
        open_for_training(folder)


TINY = ("model.width=32", "model.layers=3", "model.heads=2", "model.feed_forward=16", "batch=4", "warmup=1")


def train(what: str, folder: Path, *settings: str) -> Path:
    options = ["--steps", "1", "--device", "cpu", "--threads", "1", "--precision", "32-true"]
    options += ["--tensorboard", "False"]
    chosen = [word for setting in settings for word in ("--set", setting)]
    assert main(["train", what, "--recipe", "paper", "--corpus", str(folder), *options, *chosen]) == 0
    run = Path("runs/paper") / what
    assert checkpoint.latest(run) == run / "step_1"
    return run / "step_1"


def test_the_published_recipe_trains_on_a_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    folder = write_folder(tmp_path / "data")
    step = train("vae", folder, *TINY, "codec=hml", "model.features=263")
    config = checkpoint.read_document(step, "config")["config"]
    assert (config["codec"], config["loss"], config["model"]["features"]) == ("hml", "published", 263)
    step = train("teacher", folder, *TINY, "text_encoder=minilm", "model.text_dim=384")
    assert all(value.isfinite().all() for value in checkpoint.read_tensors(step, "teacher_ema").values())
    train("pcm-1", folder, "batch=4", "warmup=1", "text_encoder=minilm")
