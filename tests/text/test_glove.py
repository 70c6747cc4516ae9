"""Words of the published evaluators: the classes by hand, tables from files, and pickles that must not run."""

import os
import pickle
from pathlib import Path

import numpy as np
import pytest
import torch

from moveset.data.glove_files import read_glove, read_vocabulary
from moveset.data.humanml3d import parse_caption
from moveset.data.plain_pickle import read_plain_pickle
from moveset.errors import FormatError, InputError
from moveset.text.glove import CLASSES, OWN_CLASSES, GloveWords

WORDS = ("sos", "eos", "unk", "a", "man", "walk", "left", "slowly", "ball", "arm")


def write_vocabulary(folder, words=WORDS, width=6, protocol=4, order=None):
    """The three files; rows of the table in another order than the list of words."""
    folder.mkdir(parents=True, exist_ok=True)
    order = order or sorted(words)
    vectors = np.random.default_rng(0).standard_normal((len(order), width))
    np.save(folder / "our_vab_data.npy", vectors)
    (folder / "our_vab_words.pkl").write_bytes(pickle.dumps(list(words), protocol))
    (folder / "our_vab_idx.pkl").write_bytes(pickle.dumps({word: k for k, word in enumerate(order)}, protocol))
    return {word: torch.from_numpy(vectors[k]).float() for k, word in enumerate(order)}


@pytest.fixture
def words():
    table = torch.arange(len(WORDS) * 4.0).reshape(len(WORDS), 4) + 1
    return GloveWords(WORDS, table)


def test_fifteen_classes_in_the_published_order():
    assert " ".join(CLASSES) == (
        "VERB NOUN DET ADP NUM AUX PRON ADJ ADV Loc_VIP Body_VIP Obj_VIP Act_VIP Desc_VIP OTHER"
    )
    assert [len(OWN_CLASSES[name]) for name in CLASSES[9:14]] == [12, 13, 10, 34, 12]
    assert sum(map(len, OWN_CLASSES.values())) == len(frozenset().union(*OWN_CLASSES.values()))


def test_words_and_classes_by_hand(words):
    caption = parse_caption("A man walks left, zorbing.#a/DET man/NOUN walk/VERB left/ADV zorb/VERB man/X#0.0#0.0")
    vectors, classes, lengths = words.read([caption])
    assert lengths.tolist() == [8]
    said = ["sos", "a", "man", "walk", "left", "unk", "man", "eos"]
    torch.testing.assert_close(vectors[0], words.vectors[[WORDS.index(word) for word in said]])
    # A verb that has a class of its own, a word the table has not, and a part of speech without a class.
    named = ["OTHER", "DET", "NOUN", "Act_VIP", "Loc_VIP", "OTHER", "OTHER", "OTHER"]
    assert [CLASSES[k] for k in classes[0].argmax(dim=-1)] == named
    assert classes[0].sum(dim=-1).tolist() == [1.0] * 8


def test_a_word_outside_the_table_has_no_class_of_its_own():
    table = GloveWords(("sos", "eos", "unk"), torch.eye(3))
    _, classes, _ = table.read([parse_caption("walk#walk/VERB#0#0")])
    assert classes[0].argmax(dim=-1).tolist() == [14, 14, 14]


@pytest.mark.parametrize("count", [0, 1, 19, 20, 21, 40])
def test_twenty_tokens_between_the_marks(words, count):
    tokens = " ".join(["walk/VERB"] * count)
    long, short = (parse_caption(f"x#{t}#0#0") for t in (tokens, "a/DET"))
    vectors, classes, lengths = words.read([long, short])
    kept = min(count, 20)
    assert lengths.tolist() == [kept + 2, 3]
    assert vectors.shape[1] == classes.shape[1] == max(kept + 2, 3)
    torch.testing.assert_close(vectors[0, kept + 1], words.vectors[1])
    assert not vectors[1, 3:].any()
    assert not classes[1, 3:].any()


def test_a_sentence_without_tokens_is_refused(words):
    with pytest.raises(InputError, match="no word/PART_OF_SPEECH tokens"):
        words.read(["a man walks"])
    with pytest.raises(InputError, match="at least one caption"):
        words.read([])
    with pytest.raises(InputError, match="no part of speech"):
        words.read([parse_caption("x#walk#0#0")])


def test_a_table_needs_its_marks():
    with pytest.raises(FormatError, match="'unk'"):
        GloveWords(("sos", "eos", "a"), torch.zeros(3, 2))
    with pytest.raises(FormatError, match="do not fit"):
        GloveWords(WORDS, torch.zeros(3, 2))


@pytest.mark.parametrize("protocol", range(pickle.HIGHEST_PROTOCOL + 1))
def test_vocabularies_of_every_protocol(tmp_path, protocol):
    # More than a batch of a thousand, memoised and repeated strings, and rows that need 1, 2 and 4 bytes.
    many = (*WORDS, *(f"wörd{k}" for k in range(70_000 if protocol == 4 else 1500)))
    truth = write_vocabulary(tmp_path, many, width=2, protocol=protocol)
    found, vectors = read_vocabulary(tmp_path)
    assert found == many
    torch.testing.assert_close(vectors, torch.stack([truth[word] for word in many]))


def test_a_pickle_that_would_run_something_does_not(tmp_path):
    class Attack:
        def __reduce__(self):
            return os.system, (f"touch {tmp_path / 'ran'}",)

    for protocol in range(pickle.HIGHEST_PROTOCOL + 1):
        for payload in ([Attack()], {"a": Attack()}, ["a", [1, 2]], [1.5], [None], [True], "a", [b"a"]):
            path = tmp_path / "x.pkl"
            path.write_bytes(pickle.dumps(payload, protocol))
            with pytest.raises(FormatError, match=r"x\.pkl (is no pickled|holds one)"):
                read_plain_pickle(path)
    assert not (tmp_path / "ran").exists()


def test_damaged_pickles_fail_with_one_sentence(tmp_path):
    whole = pickle.dumps({f"word{k}": k for k in range(100)})
    path = tmp_path / "x.pkl"
    assert read_plain_pickle(_written(path, whole)) == pickle.loads(whole)
    for cut in range(0, len(whole) - 1, 9):
        with pytest.raises(FormatError):
            read_plain_pickle(_written(path, whole[:cut]))
    rng = np.random.default_rng(0)
    for _ in range(150):
        broken = bytearray(whole)
        broken[rng.integers(len(whole))] = rng.integers(256)
        try:
            found = read_plain_pickle(_written(path, bytes(broken)))
        except FormatError:
            continue
        assert all(type(v) in (str, int) for pair in found.items() for v in pair)
    # Nothing nests, so nothing can contain itself.
    loop = b"\x80\x04]\x94h\x00a."
    assert pickle.loads(loop)[0][0] is not None
    with pytest.raises(FormatError, match="a list within"):
        read_plain_pickle(_written(path, loop))


def _written(path: Path, data: bytes) -> Path:
    path.write_bytes(data)
    return path


def test_tables_that_do_not_belong_together(tmp_path):
    write_vocabulary(tmp_path)
    np.save(tmp_path / "our_vab_data.npy", np.zeros((3, 4)))
    with pytest.raises(FormatError, match="gives 'sos' the row"):
        read_vocabulary(tmp_path)
    np.save(tmp_path / "our_vab_data.npy", np.full((10, 4), np.nan))
    with pytest.raises(FormatError, match="no table of finite vectors"):
        read_vocabulary(tmp_path)
    (tmp_path / "our_vab_idx.pkl").unlink()
    with pytest.raises(InputError, match=r"has no our_vab_idx\.pkl"):
        read_glove(tmp_path)


def test_glove_text(tmp_path):
    path = tmp_path / "glove.6B.3d.txt"
    path.write_text("unk 0 0 0.5\nwalk 1 2 3\nsos -1 0 0\neos 4 5 6\nwalk 9 9 9\n")
    found, vectors = read_glove(path)
    assert found == ("unk", "walk", "sos", "eos")
    assert vectors[1].tolist() == [1.0, 2.0, 3.0]
    for text in ("unk 0 0\nwalk 1\n", "walk\n", "walk 1 x\n", "walk 1 nan\n", "", "a" * 100_000):
        path.write_text(text)
        with pytest.raises(FormatError, match="glove"):
            read_glove(path)
    with pytest.raises(InputError, match="cannot read"):
        read_glove(tmp_path / "nothing.txt")
