"""Items: what they hold, what is left out, how captions and crops are drawn."""

import pytest
import torch

from moveset.data.captions import mirror_text
from moveset.data.humanml3d import HUMANML3D, KIT, HumanML3D
from moveset.errors import FormatError, InputError
from moveset.evaluation.samples import LONGEST, Sample, open_test_set
from moveset.motion.features import get_codec
from tests.evaluation.corpora import content_corpus
from tests.training.hml_folder import write_folder


@pytest.fixture(scope="module")
def corpus(tmp_path_factory):
    return content_corpus(tmp_path_factory.mktemp("corpus") / "corpus.safetensors", short=3)


@pytest.fixture(scope="module")
def items(corpus):
    return open_test_set(corpus, "test")


def generator(seed=0):
    return torch.Generator().manual_seed(seed)


def test_every_clip_and_its_mirror_image_is_an_item(items):
    assert len(items) == 2 * 40
    assert len({item.name for item in items.items}) == 80
    assert items.dropped == {"fewer than 24 frames": 6}


def test_plain_items_alone(corpus):
    plain = open_test_set(corpus, "test", composed=False, mirrored=False)
    assert len(plain) == 39
    assert plain.dropped == {"fewer than 24 frames": 3}


def test_lengths_are_honest(items):
    for item in items.items[:4]:
        assert len(item.features()) == item.rows == len(item.joints()) - 1
        assert item.motion().joints.shape == item.joints().shape


def test_a_crop_has_the_joints_of_its_features(items):
    item = max(items.items, key=lambda item: item.rows)
    draw = Sample(item, item.captions[0], start=7, rows=12)
    assert torch.equal(draw.joints(), item.joints()[7:20])
    assert torch.equal(draw.features(), item.features()[7:19])


def test_a_mirror_image_is_told_and_labelled_as_one(items):
    by_name = {item.name: item for item in items.items}
    plain = next(item for item in items.items if item.label == ("wave-left-hand",))
    mirrored = by_name[f"{plain.name} mirrored"]
    assert mirrored.label == ("wave-right-hand",)
    assert mirrored.captions == tuple(mirror_text(text) for text in plain.captions)


def test_labels_keep_both_contents_of_a_composition(items):
    assert next(item for item in items.items if item.name == "both").label == ("walk", "wave-left-hand")


def test_a_prompt_is_one_of_the_captions(items):
    assert [d.prompt for d in items.draw(generator())] != [d.prompt for d in items.draw(generator(1))]
    for draw in items.draw(generator()):
        assert draw.prompt == draw.caption in draw.item.captions
        assert (draw.start, draw.rows, draw.frames) == (0, draw.item.rows, draw.item.rows + 1)


def test_all_captions_are_drawn_alike(items):
    item = items.items[0]
    assert len(set(item.captions)) == 3
    draws = [items.draw(generator(k))[0].caption for k in range(90)]
    assert min(draws.count(caption) for caption in item.captions) > 15


def test_a_corpus_is_known_by_its_bytes(items, corpus, tmp_path):
    copy = tmp_path / "other name.safetensors"
    copy.write_bytes(corpus.read_bytes())
    assert open_test_set(copy, "test").sha256 == items.sha256
    assert open_test_set(content_corpus(tmp_path / "b.safetensors", frames=41), "test").sha256 != items.sha256


def test_a_few_items_at_random(items):
    few = items.limited(10)
    assert len(few) == 10
    assert [item.name for item in few.items] == [i.name for i in items.items if i in few.items]
    assert few.dropped["left out at random"] == 70
    assert items.limited(1000) is items


def test_an_empty_split_is_refused(corpus):
    with pytest.raises(InputError, match="no val clips of 24"):
        open_test_set(corpus, "val")


def test_a_damaged_corpus_is_refused(corpus, tmp_path):
    broken = tmp_path / "broken.safetensors"
    broken.write_bytes(corpus.read_bytes()[:-100])
    with pytest.raises(FormatError):
        open_test_set(broken, "test")


@pytest.mark.parametrize("layout", [HUMANML3D, KIT])
def test_folders_follow_the_sets_own_rules(tmp_path, layout):
    folder = write_folder(tmp_path / "data", layout)
    data = HumanML3D.open(folder)
    items = open_test_set(folder, "train")
    assert [item.rows for item in items.items] == [item.stop - item.start for item in data.items("train")]
    assert items.labels is None
    assert items.codec.name == layout.codec
    assert sum(items.dropped.values()) == 1  # "short"
    for item, entry in zip(items.items, data.items("train"), strict=True):
        assert torch.equal(item.features(), data.features(entry.name)[entry.start : entry.stop])
        assert all(caption.tokens for caption in item.captions)


def test_crops_are_whole_tokens_single_or_double(tmp_path):
    items = open_test_set(write_folder(tmp_path / "data"), "train")
    long = next(k for k, item in enumerate(items.items) if item.rows == 199)
    draws = [items.draw(generator(k)) for k in range(120)]
    for drawn in draws:
        for draw in drawn:
            tokens = draw.item.rows // 4
            assert draw.rows in {min(4 * tokens, LONGEST), 4 * (tokens - 1)}
            assert 0 <= draw.start <= draw.item.rows - draw.rows
            assert len(draw.features()) == draw.rows
    double = sum(drawn[long].rows == 192 for drawn in draws) / len(draws)
    assert 0.2 < double < 0.47  # one in three
    assert len({drawn[long].start for drawn in draws if drawn[long].rows == 196}) == 4


def test_kit_joints_are_turned_to_the_axes_of_motion(tmp_path):
    items = open_test_set(write_folder(tmp_path / "data", KIT), "train")
    codec, item = get_codec("kit"), items.items[1]
    assert torch.equal(item.joints()[..., 0], -codec.joints(item.features())[..., 0])
    assert torch.equal(item.joints()[..., 1:], codec.joints(item.features())[..., 1:])


def test_long_motions_are_for_rollouts(tmp_path):
    folder = write_folder(tmp_path / "data")
    with pytest.raises(InputError, match=r"no train motion of a length .*200 frames"):
        open_test_set(folder, "train", long=True)
    import numpy as np

    np.save(folder / "new_joint_vecs" / "long.npy", np.zeros((333, 263), dtype=np.float32))
    items = open_test_set(folder, "train", long=True)
    assert [(item.rows, item.cropped) for item in items.items] == [(333, False)]
