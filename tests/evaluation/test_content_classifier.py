import json
import math

import pytest
import torch

from moveset.data.corpus import Corpus
from moveset.data.synthetic import synthetic_corpus, synthetic_motion
from moveset.errors import FormatError, InputError
from moveset.evaluation.content_classifier import ContentClassifier, ContentClassifierConfig, frame_features
from moveset.evaluation.content_training import (
    Confusion,
    LabelledClip,
    class_names,
    clip_features,
    confusion,
    labelled_clips,
    main,
    pad,
    train_classifier,
)
from moveset.motion import rotations


@pytest.fixture(scope="module")
def corpus(tmp_path_factory):
    return Corpus.open(synthetic_corpus(tmp_path_factory.mktemp("corpus") / "synthetic.safetensors", 120, seed=1))


@pytest.fixture(scope="module")
def trained(corpus):
    return train_classifier(corpus, epochs=12, batch=16, min_takes=3, width=32, seed=0)


@pytest.fixture
def untrained():
    torch.manual_seed(0)
    return ContentClassifierConfig(labels=("a", "b", "c"), width=16, features=8).build().eval()


def _joints(kind="walk", frames=60, seed=0):
    return synthetic_motion(kind, frames, seed=seed).joints


def test_it_learns_to_tell_motions_apart(corpus, trained):
    model, curve = trained
    result = confusion(model, labelled_clips(corpus, "test"))
    assert result.clips >= 12
    assert result.accuracy >= 0.9  # chance is 1 / 12
    assert curve.losses[curve.best_epoch] == min(curve.losses)


def test_mirrored_motions_are_the_mirrored_class(corpus, trained):
    model, _ = trained
    clips = labelled_clips(corpus, "test") + labelled_clips(corpus, "val")
    sided = [clip for clip in clips if clip.label.endswith(("left", "right", "left-hand", "right-hand"))]
    mirrored = [clip.mirrored() for clip in sided]
    assert len(sided) >= 4
    assert all(a.label != b.label for a, b in zip(sided, mirrored, strict=True))
    assert confusion(model, mirrored).accuracy >= 0.9


def test_training_is_repeatable_and_leaves_the_global_generator_alone(corpus):
    state = torch.get_rng_state()
    first, _ = train_classifier(corpus, epochs=1, min_takes=3, width=8, seed=3)
    second, _ = train_classifier(corpus, epochs=1, min_takes=3, width=8, seed=3)
    assert torch.equal(torch.get_rng_state(), state)
    assert all(torch.equal(a, b) for a, b in zip(first.parameters(), second.parameters(), strict=True))


def test_where_a_clip_stands_and_faces_does_not_matter():
    motion = synthetic_motion("walk-turn-left", 40)
    moved = motion.transformed(rotations.yaw(torch.tensor(2.1)), torch.tensor((3.0, 0.0, -7.0)))
    n = torch.tensor([40])
    torch.testing.assert_close(
        frame_features(moved.joints[None], n), frame_features(motion.joints[None], n), atol=2e-4, rtol=0
    )


def test_features_are_metres_per_second_and_radians_per_second_in_the_body_s_frame():
    # A rigid body that travels 1 m/s to its left while turning 90 degrees a second to the left.
    time = torch.arange(21) / 20
    pose = _joints(frames=1)
    turn = rotations.yaw(0.5 * math.pi * time)
    left = rotations.rotate(turn, torch.tensor((1.0, 0.0, 0.0)))
    path = torch.cat((torch.zeros(1, 3), (0.5 * (left[1:] + left[:-1]) / 20).cumsum(0)))
    pelvis = pose[:, :1] * torch.tensor((1.0, 0.0, 1.0))
    joints = rotations.rotate(turn[:, None], pose - pelvis) + path[:, None]
    features = frame_features(joints[None], torch.tensor([21]))[0, 1:-1]
    velocity = features[:, 66:132].reshape(-1, 22, 3)[:, 0]
    torch.testing.assert_close(velocity, torch.tensor((1.0, 0.0, 0.0)).expand(19, 3), atol=0.02, rtol=0)
    torch.testing.assert_close(features[:, -1], torch.full((19,), math.pi / 2), atol=1e-3, rtol=0)
    torch.testing.assert_close(features[:, :66], features[:1, :66].expand(19, -1), atol=1e-4, rtol=0)


def test_padding_and_company_do_not_matter(untrained):
    clips = [_joints("walk", 31), _joints("run", 60), _joints("bow", 2), _joints("bow", 1)]
    joints, lengths = pad(clips)
    together = untrained(joints, lengths)
    padding = torch.arange(60) >= lengths[:, None]
    noisy = torch.cat((joints.masked_fill(padding[..., None, None], 1e4), torch.full((4, 9, 22, 3), 7.0)), dim=1)
    torch.testing.assert_close(untrained(noisy, lengths), together, atol=1e-5, rtol=0)
    for clip, row in zip(clips, together, strict=True):
        torch.testing.assert_close(untrained(clip[None], torch.tensor([len(clip)]))[0], row, atol=1e-5, rtol=0)


def test_gradients_reach_every_parameter(untrained):
    joints, lengths = pad([_joints("walk", 31), _joints("run", 60)])
    untrained(joints, lengths).square().sum().backward()
    assert all(p.grad is not None and p.grad.any() for p in untrained.parameters())


def test_features_keep_the_order_of_the_clips(untrained):
    clips = [_joints("run", 60), _joints("walk", 31), _joints("bow", 45)]
    features = clip_features(untrained, clips)
    assert features.shape == (3, 8)
    for clip, row in zip(clips, features, strict=True):
        torch.testing.assert_close(untrained.features(clip[None], torch.tensor([len(clip)]))[0], row, atol=1e-5, rtol=0)


def test_predictions_are_probabilities_with_names(trained):
    model, _ = trained
    said = model.predict(_joints("run", 60, seed=99)[None])
    assert said.labels == ("run",)
    assert said.probabilities.sum().item() == pytest.approx(1.0, abs=1e-5)
    with pytest.raises(InputError, match="22, 3"):
        model.predict(torch.zeros(1, 10, 21, 3))


def test_saved_and_loaded_it_says_the_same(trained, tmp_path):
    model, _ = trained
    again = ContentClassifier.load(model.save(tmp_path / "judge"))
    joints, lengths = pad([_joints("run", 60), _joints("bow", 40)])
    assert again.config == model.config
    assert torch.equal(again(joints, lengths), model(joints, lengths))


def _truncate(folder):
    path = folder / "model.safetensors"
    path.write_bytes(path.read_bytes()[:-100])


def _rename_kind(folder):
    stored = json.loads((folder / "model.json").read_text())
    (folder / "model.json").write_text(json.dumps(stored | {"kind": "nonsense"}))


def _shrink(folder):
    stored = json.loads((folder / "model.json").read_text())
    stored["config"]["width"] = 8
    (folder / "model.json").write_text(json.dumps(stored))


def _blank(folder):
    (folder / "model.json").write_text("{}")


@pytest.mark.parametrize("damage", [_truncate, _rename_kind, _shrink, _blank])
def test_damaged_files_are_refused_in_a_sentence(untrained, tmp_path, damage):
    folder = untrained.save(tmp_path / "judge")
    damage(folder)
    with pytest.raises(FormatError) as caught:
        ContentClassifier.load(folder)
    assert "\n" not in str(caught.value)


def test_missing_files_are_the_user_s_mistake(tmp_path):
    with pytest.raises(InputError, match=r"model\.json"):
        ContentClassifier.load(tmp_path)


def test_classes_need_enough_takes_and_a_mirrored_take_counts():
    clips = [LabelledClip(torch.zeros(30, 22, 3), "wave-left-hand", f"t{k}") for k in range(3)]
    clips += [LabelledClip(torch.zeros(30, 22, 3), "walk", "only")] * 5  # five cuts of one take
    assert class_names(clips, 3) == ("wave-left-hand", "wave-right-hand")


def test_confusion_counts():
    table = Confusion(("a", "b", "c"), torch.tensor([[8, 2, 0], [0, 1, 1], [0, 0, 0]]))
    assert table.clips == 12
    assert table.accuracy == pytest.approx(9 / 12)
    assert table.balanced_accuracy == pytest.approx((0.8 + 0.5) / 2)


def test_a_corpus_too_small_is_refused(corpus):
    with pytest.raises(InputError, match="min_takes"):
        train_classifier(corpus, min_takes=1000)


def test_the_command_line_trains_one_that_benchmarks_can_load(tmp_path, monkeypatch, capsys):
    corpus = synthetic_corpus(tmp_path / "synthetic.safetensors", 60, seed=1)
    words = ["--corpus", str(corpus), "--out", str(tmp_path / "made"), "--epochs", "1", "--min-takes", "2"]
    monkeypatch.setattr("sys.argv", ["content_training", *words])
    main()
    assert "test: " in capsys.readouterr().out
    assert len(ContentClassifier.load(tmp_path / "made").labels) > 1
