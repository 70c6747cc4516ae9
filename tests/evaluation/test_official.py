"""The published evaluators: fake checkpoints of the authors' form, an oracle written from the specification."""

import json
import math
import os
import pickle

import numpy as np
import pytest
import torch
from torch.nn import functional as F

from moveset.cli.__main__ import main
from moveset.data.humanml3d import HUMANML3D, KIT, parse_caption
from moveset.errors import FormatError, InputError
from moveset.evaluation.evaluator import Evaluator
from moveset.evaluation.official import BIAS, biased, import_official, read_checkpoint, read_official
from moveset.text.glove import CLASSES

SMALL = {"features": 263, "movement": 6, "latent": 5, "word": 7, "classes": 15, "text": 4, "motion": 3, "joint": 8}
PUBLISHED = SMALL | dict.fromkeys(("movement", "latent", "text", "joint"), 512) | {"word": 300, "motion": 1024}


def checkpoint(*, features, movement, latent, word, classes, text, motion, joint, seed=0):
    """The three encoders under the authors' names, with random weights."""
    rng = torch.Generator().manual_seed(seed)

    def linear(out, into):
        return {
            "weight": torch.randn(out, into, generator=rng) / math.sqrt(into),
            "bias": torch.randn(out, generator=rng),
        }

    def recurrent(hidden, into):
        state = {"hidden": torch.randn(2, 1, hidden, generator=rng)}
        layers = {"input_emb": linear(hidden, into), "output_net.0": linear(hidden, 2 * hidden)}
        layers["output_net.1"] = {"weight": torch.rand(hidden, generator=rng) + 0.5, "bias": torch.randn(hidden)}
        layers["output_net.3"] = linear(joint, hidden)
        for end in ("l0", "l0_reverse"):
            for part in ("ih", "hh"):
                made = linear(3 * hidden, hidden)
                state |= {f"gru.{kind}_{part}_{end}": value for kind, value in made.items()}
        return state | _flat(layers)

    conv = [linear(movement, (features - 4) * 4), linear(latent, movement * 4)]
    for layer, width in zip(conv, (features - 4, movement), strict=True):
        layer["weight"] = layer["weight"].reshape(len(layer["weight"]), width, 4)
    return {
        "movement_encoder": _flat({"main.0": conv[0], "main.3": conv[1], "out_net": linear(latent, latent)}),
        "motion_encoder": recurrent(motion, latent),
        "text_encoder": recurrent(text, word) | _flat({"pos_emb": linear(word, classes)}),
        "opt_motion_encoder": {"state": {}, "param_groups": [{"lr": 1e-4, "params": [0]}]},
        "epoch": 100,
        "iter": 12_345,
    }


def _flat(layers):
    return {f"{name}.{kind}": value for name, layer in layers.items() for kind, value in layer.items()}


def write_official(folder, dataset="t2m", sizes=SMALL, *, meta="Comp_v6_KLD005", legacy=False):
    """A checkpoints folder; its statistics have the bias in them."""
    layout = {"t2m": HUMANML3D, "kit": KIT}[dataset]
    sizes = sizes | {"features": layout.features}
    home = folder / dataset
    (home / "text_mot_match" / "model").mkdir(parents=True)
    (home / meta / "meta").mkdir(parents=True)
    state = checkpoint(**sizes)
    torch.save(state, home / "text_mot_match" / "model" / "finest.tar", _use_new_zipfile_serialization=not legacy)
    rng = np.random.default_rng(1)
    mean, std = rng.standard_normal(layout.features), rng.random(layout.features) + 0.5
    std[:4] = 0.001
    std[-4:] = 0.014
    np.save(home / meta / "meta" / "mean.npy", mean)
    np.save(home / meta / "meta" / "std.npy", std)
    return state, torch.from_numpy(mean).float(), torch.from_numpy(std).float()


def gru(x, h, state, end):
    """The last state of one direction over one sequence, by the equations."""
    w, u = state[f"gru.weight_ih_{end}"], state[f"gru.weight_hh_{end}"]
    a, b = state[f"gru.bias_ih_{end}"], state[f"gru.bias_hh_{end}"]
    for item in x.flip(0) if end.endswith("reverse") else x:
        (ri, zi, ni), (rh, zh, nh) = (w @ item + a).chunk(3), (u @ h + b).chunk(3)
        z, n = torch.sigmoid(zi + zh), torch.tanh(ni + torch.sigmoid(ri + rh) * nh)
        h = (1 - z) * n + z * h
    return h


def encode(x, state):
    """One sequence to the common space."""
    x = x @ state["input_emb.weight"].T + state["input_emb.bias"]
    last = [gru(x, state["hidden"][k, 0], state, end) for k, end in enumerate(("l0", "l0_reverse"))]
    h = torch.cat(last) @ state["output_net.0.weight"].T + state["output_net.0.bias"]
    h = (h - h.mean()) / (h.var(unbiased=False) + 1e-5).sqrt()
    h = F.leaky_relu(h * state["output_net.1.weight"] + state["output_net.1.bias"], 0.2)
    return h @ state["output_net.3.weight"].T + state["output_net.3.bias"]


def movement(x, state):
    """Tokens of one clip (F, D - 4) that zeros follow (as in a batch), by four taps of every second frame."""
    tokens, x = len(x) // 4, F.pad(x, (0, 0, 0, 8))
    for name in ("main.0", "main.3"):
        x = F.pad(x, (0, 0, 1, 1))
        taps = torch.stack([x[k : len(x) - 3 + k : 2] for k in range(4)])
        x = F.leaky_relu(torch.einsum("kfc,ock->fo", taps, state[f"{name}.weight"]) + state[f"{name}.bias"], 0.2)
    return (x @ state["out_net.weight"].T + state["out_net.bias"])[:tokens]


@pytest.fixture
def official(tmp_path):
    state, mean, std = write_official(tmp_path)
    return state, mean, std, read_official(tmp_path)


def test_motions_equal_the_specification(official):
    state, *_, found = official
    x = torch.randn(3, 24, 263, generator=torch.Generator().manual_seed(2))
    lengths = torch.tensor([24, 8, 17])
    for k, length in enumerate(lengths):
        x[k, length:] = 0
    got = found.module.embed_motion(x, lengths)
    # The published loader pads every clip with zeros to 196 frames; a clip counts in whole tokens.
    padded = F.pad(x, (0, 0, 0, 196 - 24))
    for k, length in enumerate(lengths):
        tokens = movement(padded[k, :, :-4], state["movement_encoder"])[: length // 4]
        torch.testing.assert_close(got[k], encode(tokens, state["motion_encoder"]), rtol=1e-4, atol=1e-5)
    x[..., -4:] = 9.0
    torch.testing.assert_close(found.module.embed_motion(x, lengths), got)


def test_texts_equal_the_specification(official):
    state, *_, found = official
    rng = torch.Generator().manual_seed(3)
    words, lengths = torch.randn(3, 9, 7, generator=rng), torch.tensor([4, 9, 3])
    classes = F.one_hot(torch.randint(15, (3, 9), generator=rng), 15).float()
    got = found.module.embed_text(words, classes, lengths)
    text = state["text_encoder"]
    for k, length in enumerate(lengths):
        x = words[k, :length] + classes[k, :length] @ text["pos_emb.weight"].T + text["pos_emb.bias"]
        torch.testing.assert_close(got[k], encode(x, text), rtol=1e-4, atol=1e-5)


def test_the_published_sizes_have_the_published_counts(tmp_path):
    path = tmp_path / "finest.tar"
    torch.save(checkpoint(**PUBLISHED), path)
    module = read_checkpoint(path)
    counts = [sum(p.numel() for p in part.parameters()) for part in (module.movement, module.motion, module.text)]
    assert counts == [1_842_688, 15_747_584, 4_100_288]
    assert not module.training
    assert not any(p.requires_grad for p in module.parameters())


def test_statistics_are_the_evaluators_own(official):
    _, mean, std, found = official
    assert torch.equal(found.module.mean, mean)
    assert torch.equal(found.module.std, std)
    assert found.layout is HUMANML3D
    assert [path.name for path in found.sources.values()] == ["finest.tar", "mean.npy", "std.npy"]


def test_the_bias_of_root_and_contacts(tmp_path):
    std = torch.linspace(0.5, 1.0, 263)
    with pytest.raises(InputError, match=r"foot contacts is 1, above 0\.02.*--bias 25"):
        biased(std, None)
    scaled = biased(std, BIAS)
    torch.testing.assert_close(scaled[:4], std[:4] / 25)
    torch.testing.assert_close(scaled[-4:], std[-4:] / 25)
    assert torch.equal(scaled[4:-4], std[4:-4])
    assert torch.equal(biased(std, 1), std)
    with pytest.raises(InputError, match="not in 1 to 1000"):
        biased(std, 0.2)
    # The data set's own files, by the names that it gives them.
    write_official(tmp_path)
    (tmp_path / "set").mkdir()
    np.save(tmp_path / "set" / "Mean.npy", np.zeros(263))
    np.save(tmp_path / "set" / "Std.npy", std.numpy())
    torch.testing.assert_close(read_official(tmp_path, statistics=tmp_path / "set", bias=25).module.std, scaled)


def test_which_data_set(tmp_path):
    write_official(tmp_path, "kit")
    assert read_official(tmp_path).layout is KIT
    assert read_official(tmp_path / "kit").module.config.features == 251
    write_official(tmp_path, "t2m", meta="Comp_v6_KLD01")
    with pytest.raises(InputError, match="t2m and kit; say which"):
        read_official(tmp_path)
    assert read_official(tmp_path, "t2m").layout is HUMANML3D
    for wrong, match in ((tmp_path / "kit" / "nothing", "has no t2m/text_mot_match"), (tmp_path, "unknown data set")):
        with pytest.raises(InputError, match=match):
            read_official(wrong, "bandai" if wrong == tmp_path else None)
    other = (tmp_path / "kit").rename(tmp_path / "other")
    with pytest.raises(InputError, match="cannot be told from its name"):
        read_official(other)
    with pytest.raises(FormatError, match="judges 251 features, where humanml3d has 263"):
        read_official(other, "t2m")


def test_copies_of_statistics_must_agree(tmp_path):
    _, mean, _ = write_official(tmp_path)
    for name in ("Comp_v6_KLD01", "Comp_v6_KLD1"):
        (tmp_path / "t2m" / name / "meta").mkdir(parents=True)
        for part in ("mean", "std"):
            data = (tmp_path / "t2m" / "Comp_v6_KLD005" / "meta" / f"{part}.npy").read_bytes()
            (tmp_path / "t2m" / name / "meta" / f"{part}.npy").write_bytes(data)
    assert torch.equal(read_official(tmp_path).module.mean, mean)
    np.save(tmp_path / "t2m" / "Comp_v6_KLD1" / "meta" / "mean.npy", np.zeros(263))
    with pytest.raises(InputError, match="statistics that differ"):
        read_official(tmp_path)


def fails(path, match):
    with pytest.raises(FormatError, match=match) as caught:
        read_checkpoint(path)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("legacy", [False, True])
def test_truncated_checkpoints_fail_with_one_sentence(tmp_path, legacy):
    path = tmp_path / "finest.tar"
    torch.save(checkpoint(**SMALL), path, _use_new_zipfile_serialization=not legacy)
    whole = path.read_bytes()
    assert read_checkpoint(path).config.joint == SMALL["joint"]
    for share in (0, 0.01, 0.1, 0.5, 0.9, 0.999):
        path.write_bytes(whole[: int(share * len(whole))])
        fails(path, "truncated or no checkpoint")


def test_foreign_and_hostile_checkpoints_fail_with_one_sentence(tmp_path):
    class Attack:
        def __reduce__(self):
            return os.system, (f"touch {tmp_path / 'ran'}",)

    path = tmp_path / "finest.tar"
    for payload in ({"text_encoder": Attack()}, Attack()):
        for new in (False, True):
            torch.save(payload, path, _use_new_zipfile_serialization=new)
            fails(path, "no checkpoint of plain tensors")
    assert not (tmp_path / "ran").exists()
    path.write_text("not a checkpoint")
    fails(path, "truncated or no checkpoint")
    for payload, match in (
        (torch.zeros(3), "holds one Tensor"),
        ({"state_dict": {}}, "has no 'movement_encoder'"),
        (checkpoint(**SMALL) | {"text_encoder": {}}, "is not an evaluator"),
        (
            checkpoint(**SMALL) | {"text_encoder": {"lm_head.weight": torch.zeros(2)}},
            "unknown weight text_encoder.lm_head",
        ),
        (
            checkpoint(**SMALL) | {"motion_encoder": checkpoint(**SMALL | {"latent": 4})["motion_encoder"]},
            "is not an eval",
        ),
    ):
        torch.save(payload, path)
        fails(path, match)
    state = checkpoint(**SMALL)
    state["text_encoder"]["hidden"][0] = math.nan
    torch.save(state, path)
    fails(path, r"not finite in 'text\.hidden'")
    with pytest.raises(InputError, match="there is no"):
        read_checkpoint(tmp_path / "nothing.tar")


def test_statistics_that_do_not_fit(tmp_path):
    write_official(tmp_path)
    meta = tmp_path / "t2m" / "Comp_v6_KLD005" / "meta"
    good = np.load(meta / "std.npy")
    for bad in (good[:251], np.where(np.arange(263) == 7, 0, good), np.full(263, np.inf)):
        np.save(meta / "std.npy", bad)
        with pytest.raises(FormatError, match="does not hold 263 usable numbers"):
            read_official(tmp_path)
    (meta / "std.npy").unlink()
    (meta / "mean.npy").unlink()
    with pytest.raises(InputError, match=r"no Comp_v6_KLD\*/meta"):
        read_official(tmp_path)


VOCABULARY = ("sos", "eos", "unk", "a", "man", "walk", "left")


@pytest.fixture
def glove(tmp_path):
    folder = tmp_path / "glove"
    folder.mkdir()
    np.save(folder / "our_vab_data.npy", np.random.default_rng(4).standard_normal((len(VOCABULARY), 7)))
    (folder / "our_vab_words.pkl").write_bytes(pickle.dumps(list(VOCABULARY)))
    (folder / "our_vab_idx.pkl").write_bytes(pickle.dumps({word: k for k, word in enumerate(VOCABULARY)}))
    return folder


@pytest.mark.parametrize("dataset", ["t2m", "kit"])
def test_the_command_makes_an_evaluator_that_judges_as_specified(tmp_path, glove, capsys, dataset):
    state, mean, std = write_official(tmp_path / "checkpoints", dataset)
    out = tmp_path / "evaluator"
    assert main(["data", "import-evaluator", str(tmp_path / "checkpoints"), str(glove), str(out), "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["name"] == f"{dataset}-official"
    opened = Evaluator.open(out)
    assert (opened.card.codec, opened.card.fps) == {"t2m": ("hml", 20.0), "kit": ("kit", 12.5)}[dataset]
    assert said["parameters"] == sum(p.numel() for p in opened.module.parameters())

    # A whole item by the specification: normalised, cut to tokens, without contacts; tokens by table and class.
    x = mean + std * torch.randn(23, len(mean), generator=torch.Generator().manual_seed(5))
    padded = F.pad(((x - mean) / std)[:20], (0, 0, 0, 196 - 20))
    tokens = movement(padded[:, :-4], state["movement_encoder"])[: 20 // 4]
    expected = encode(tokens, state["motion_encoder"])
    torch.testing.assert_close(opened.embed_motions([x, x[:8]])[0], expected.double(), rtol=1e-3, atol=1e-4)

    caption = parse_caption("A man walks left, zorbing.#man/NOUN walk/VERB left/ADV zorb/VERB#0.0#0.0")
    table = torch.from_numpy(np.load(glove / "our_vab_data.npy")).float()
    rows = [VOCABULARY.index(word) for word in ("sos", "man", "walk", "left", "unk", "eos")]
    kinds = [CLASSES.index(kind) for kind in ("OTHER", "NOUN", "Act_VIP", "Loc_VIP", "OTHER", "OTHER")]
    text = state["text_encoder"]
    words = table[rows] + F.one_hot(torch.tensor(kinds), 15).float() @ text["pos_emb.weight"].T + text["pos_emb.bias"]
    torch.testing.assert_close(opened.embed_texts([caption])[0], encode(words, text).double(), rtol=1e-3, atol=1e-4)
    with pytest.raises(InputError, match="no word/PART_OF_SPEECH tokens"):
        opened.embed_texts(["a man walks"])


def test_a_table_of_another_width_does_not_fit(tmp_path, glove):
    write_official(tmp_path)
    np.save(glove / "our_vab_data.npy", np.zeros((len(VOCABULARY), 6)))
    with pytest.raises(FormatError, match="words of 6 numbers and 15 classes do not fit"):
        import_official(read_official(tmp_path), glove)


def test_the_command_fails_with_one_line(tmp_path, glove, capsys):
    write_official(tmp_path)
    path = tmp_path / "t2m" / "text_mot_match" / "model" / "finest.tar"
    path.write_bytes(path.read_bytes()[:1000])
    assert main(["data", "import-evaluator", str(tmp_path), str(glove), str(tmp_path / "out")]) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert "truncated or no checkpoint" in said
    assert not (tmp_path / "out").exists()
