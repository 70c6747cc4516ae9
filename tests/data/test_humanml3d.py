"""HumanML3D and KIT-ML folders: the sets' own rules for what is drawn from them."""

import numpy as np
import pytest
import torch

from moveset.data.humanml3d import HUMANML3D, KIT, HumanML3D, Layout, parse_caption
from moveset.errors import FormatError, InputError


def folder(path, layout: Layout, motions: dict[str, int], texts: dict[str, list[str]] | None = None, **splits):
    """A folder as researchers have it; every feature of motion k is k."""
    for part in ("new_joint_vecs", "texts"):
        (path / part).mkdir(parents=True)
    for k, (name, frames) in enumerate(motions.items()):
        np.save(path / "new_joint_vecs" / f"{name}.npy", np.full((frames, layout.features), k, dtype=np.float32))
        lines = (texts or {}).get(name, ["a man walks.#a/DET man/NOUN walk/VERB#0.0#0.0"])
        (path / "texts" / f"{name}.txt").write_text("\n".join(lines) + "\n")
    np.save(path / "Mean.npy", np.zeros(layout.features))
    np.save(path / "Std.npy", np.ones(layout.features))
    for split in ("train", "val", "test"):
        (path / f"{split}.txt").write_text("\n".join(splits.get(split, [])) + "\n")
    return path


@pytest.mark.parametrize("layout", [HUMANML3D, KIT])
def test_a_folder_is_recognised_and_read(tmp_path, layout):
    data = HumanML3D.open(folder(tmp_path, layout, {"000001": 60, "M000001": 60}, train=["000001", "M000001"]))
    assert data.layout == layout
    assert data.names == ("000001", "M000001")
    assert torch.equal(data.features("M000001"), torch.ones(60, layout.features))
    assert data.captions("000001")[0].tokens == ("a/DET", "man/NOUN", "walk/VERB")
    assert data.mean.shape == data.std.shape == (layout.features,)
    assert [i.name for i in data.items("train")] == ["000001", "M000001"]
    assert data.items("val") == ()


def test_names_without_a_motion_are_left_out_aloud(tmp_path):
    written = folder(tmp_path, HUMANML3D, {"a": 60, "b": 60}, train=["a", "lost", "gone", "lost"], test=["b"])
    with pytest.warns(
        UserWarning, match=r"2 of the motions that \S+train\.txt names are not .*, lost for one"
    ) as heard:
        data = HumanML3D.open(written)
    assert len(heard) == 1
    assert data.splits == {"train": ("a",), "val": (), "test": ("b",)}


def test_motions_on_two_sides_are_said(tmp_path):
    written = folder(tmp_path, HUMANML3D, {"a": 60, "b": 60}, train=["a", "b"], val=["b"], test=["a"])
    with pytest.warns(UserWarning, match=r"1 motions are in both train\.txt and (val|test)\.txt") as heard:
        HumanML3D.open(written)
    assert [("b for one" in str(said.message), "a for one" in str(said.message)) for said in heard] == [
        (True, False),
        (False, True),
    ]


def test_a_sentence_may_hold_any_character_of_unicode(tmp_path):
    said = "a man walks\u2028slowly\x85 on\x0b"
    data = HumanML3D.open(folder(tmp_path, HUMANML3D, {"a": 60}, {"a": [f"{said}#man/NOUN#0.0#0.0\r"]}, train=["a"]))
    assert [caption.text for caption in data.captions("a")] == [said.strip()]


@pytest.mark.parametrize("layout", [HUMANML3D, KIT])
def test_only_lengths_from_the_shortest_to_199_are_drawn(tmp_path, layout):
    lengths = {str(n): n for n in (layout.shortest - 1, layout.shortest, 199, 200)}
    data = HumanML3D.open(folder(tmp_path, layout, lengths, train=list(lengths)))
    assert [i.stop for i in data.items("train")] == [layout.shortest, 199]


def test_parts_with_their_own_sentence_become_items(tmp_path):
    texts = {
        "a": [
            "a man walks.#man/NOUN#0.0#0.0",
            "he turns.#turn/VERB#1.0#4.5",
            "he blinks.#blink/VERB#1.0#1.5",
            "he stops.#stop/VERB#5#20",
            "he also walks.#walk/VERB#nan#nan",
        ]
    }
    items = HumanML3D.open(folder(tmp_path, HUMANML3D, {"a": 150}, texts, train=["a"])).items("train")
    assert [(i.start, i.stop, len(i.captions)) for i in items] == [(0, 150, 2), (20, 90, 1), (100, 150, 1)]
    assert items[0].captions[1].text == "he also walks."


def test_times_that_are_nan_count_as_zero():
    caption = parse_caption("a man walks.#a/DET#nan#NaN")
    assert (caption.start, caption.end) == (0.0, 0.0)


@pytest.mark.parametrize("line", ["no fields", "a#b#0.0", "a#b#0.0#one", "#b#0.0#0.0", "a#b#0#0#0"])
def test_lines_of_another_form_are_refused(line):
    with pytest.raises(FormatError, match="text line"):
        parse_caption(line)


@pytest.mark.parametrize("times", ["0.0#inf", "-inf#0", "-1.0#3.0", "0#1e308", "1#-3"])
def test_times_that_no_motion_has_are_damage(tmp_path, times):
    data = HumanML3D.open(
        folder(tmp_path, HUMANML3D, {"a": 60}, {"a": [f"a man walks.#man/NOUN#{times}"]}, train=["a"])
    )
    with pytest.raises(FormatError, match=r"a\.txt: the text line .* within 0 and 86400 s; restore"):
        data.items("train")


def test_a_byte_order_mark_is_no_text(tmp_path):
    written = folder(tmp_path, HUMANML3D, {"a": 60, "b": 60}, train=["a", "b"])
    plain = HumanML3D.open(written).items("train")
    for path in (written / "train.txt", written / "texts" / "a.txt"):
        path.write_bytes(b"\xef\xbb\xbf" + path.read_bytes())
    assert HumanML3D.open(written).items("train") == plain


def test_what_is_wrong_is_said(tmp_path):
    with pytest.raises(InputError, match="new_joint_vecs"):
        HumanML3D.open(tmp_path)
    good = folder(
        tmp_path / "good", HUMANML3D, {"a": 60, "nan": 60, "thin": 60, "odd": 60}, train=["a"], val=["gone"][:0]
    )
    np.save(good / "new_joint_vecs" / "nan.npy", np.full((60, 263), np.nan))
    np.save(good / "new_joint_vecs" / "thin.npy", np.zeros((60, 262)))
    (good / "texts" / "odd.txt").write_text("nonsense\n")
    data = HumanML3D.open(good)
    for call, words in (
        (lambda: data.features("nan"), "not finite"),
        (lambda: data.features("thin"), "262"),
        (lambda: data.captions("odd"), "odd.txt"),
        (lambda: data.captions("nobody"), "nobody.txt"),
        (lambda: data.features("nobody"), "No such file"),
    ):
        with pytest.raises(InputError, match=words):
            call()
    np.save(good / "Std.npy", np.ones(251))
    with pytest.raises(FormatError, match="251"):
        _ = HumanML3D.open(good).std
    np.save(good / "Std.npy", np.zeros(263))
    with pytest.raises(FormatError, match="above 0"):
        _ = HumanML3D.open(good).std
    (good / "train.txt").write_text("missing\n")
    with pytest.raises(InputError, match="none of the 1 motions"):
        HumanML3D.open(good)
    np.save(good / "Mean.npy", np.zeros(100))
    with pytest.raises(FormatError, match="100"):
        HumanML3D.open(good)
