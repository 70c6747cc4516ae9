"""Model folders: what is written is read, what is damaged is refused, what is not needed is not touched."""

import json
import shutil
from pathlib import Path

import pytest
import torch
from safetensors.torch import save as save_safetensors

from moveset.errors import FormatError, InputError, MovesetError
from moveset.io.manifest import write_whole
from moveset.models.length import LengthPredictorConfig
from moveset.pipelines.model_config import ClipConfig
from moveset.pipelines.model_folder import ModelFolder, find_folder, save_model
from tests.bundles import tiny_bundle

BARE = {name: torch.zeros(1) for name in ClipConfig.statistics}  # which nothing here asks for


@pytest.fixture
def folder(tiny_clips, tmp_path):
    return shutil.copytree(tiny_clips, tmp_path / "tiny")


def rewrite(folder, change):
    """Edit config.json and its manifest entry, as somebody with bad intentions could."""
    import hashlib

    config = json.loads((folder / "config.json").read_text())
    change(config)
    data = json.dumps(config).encode()
    (folder / "config.json").write_bytes(data)
    manifest = json.loads((folder / "manifest.json").read_text())
    manifest["files"]["config.json"] = {"sha256": hashlib.sha256(data).hexdigest(), "bytes": len(data)}
    (folder / "manifest.json").write_text(json.dumps(manifest))


def test_networks_come_back_in_half_precision(folder):
    network = LengthPredictorConfig(text_dim=8, width=8).build().eval()
    with torch.no_grad():
        for p in network.parameters():
            p.normal_()
    config = ClipConfig(name="one")
    save_model(folder.parent / "one", config, {"length": network}, BARE, ["a"], torch.ones(1, 8))
    bundle = ModelFolder(folder.parent / "one", ClipConfig)
    assert all(value.dtype == torch.float16 for value in bundle.tensors("length.safetensors").values())
    loaded = bundle.module("length")
    assert loaded is bundle.module("length")
    assert not loaded.training
    assert not any(p.requires_grad for p in loaded.parameters())
    x = torch.randn(5, 8)
    torch.testing.assert_close(loaded(x), network.half().float()(x).detach(), atol=1e-5, rtol=1e-5)


def test_words_of_the_training_are_optional_and_checked(folder):
    captions = ["a person walks", "she bows"]

    def known(**stored):
        blobs = {name: (folder / name).read_bytes() for name in ModelFolder(folder, ClipConfig).files}
        blobs["prompts.json"] = json.dumps({"captions": captions, **stored}).encode()
        blobs["prompts.safetensors"] = save_safetensors({"pooled": torch.eye(2, 384)})
        write_whole(folder, blobs)
        return ModelFolder(folder, ClipConfig).captions

    assert known().unread("a person crawls") == ()
    assert known(words=["walk", "bow"]).unread("a person walks and crawls") == ("crawls",)
    for words in ("walk", [1], {"walk": 1}):
        with pytest.raises(FormatError, match="no list of words"):
            known(words=words)


@pytest.mark.parametrize(
    "stored", [{}, {"pooled:rounded": torch.ones(2, 384, dtype=torch.int8)}, {"pooled": torch.eye(3, 384)}]
)
def test_known_prompts_and_their_embeddings_belong_together(folder, stored):
    blobs = {name: (folder / name).read_bytes() for name in ModelFolder(folder, ClipConfig).files}
    write_whole(folder, blobs | {"prompts.safetensors": save_safetensors(stored)})
    with pytest.raises(FormatError, match="do not belong together"):
        _ = ModelFolder(folder, ClipConfig).captions


@pytest.mark.parametrize("file", ["config.json", "vae.safetensors", "normalizer.safetensors", "prompts.json"])
def test_one_flipped_bit_is_found(folder, file):
    data = bytearray((folder / file).read_bytes())
    data[len(data) // 2] ^= 1
    (folder / file).write_bytes(data)
    with pytest.raises(FormatError, match=rf"{file} is damaged.*copy it again"):
        ModelFolder(folder, ClipConfig).verify()


@pytest.mark.parametrize("size", [0, 100])
def test_truncation_is_found(folder, size):
    path = folder / "pcm-1.safetensors"
    path.write_bytes(path.read_bytes()[:size])
    with pytest.raises(FormatError, match="damaged"):
        ModelFolder(folder, ClipConfig).module("pcm-1")


def test_only_what_is_asked_for_is_read(folder):
    for unused in ("teacher", "pcm-4", "lcm-1", "length"):
        (folder / f"{unused}.safetensors").write_bytes(b"not read")
    bundle = ModelFolder(folder, ClipConfig)
    bundle.module("vae")
    bundle.module("pcm-1")
    with pytest.raises(FormatError, match="teacher"):
        bundle.module("teacher")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda c: c.update(format=2), "format 2"),
        (lambda c: c.update(format=None), "format None"),
        (lambda c: c.pop("latent"), "'latent' is missing"),
        (lambda c: c.update(colour="red"), "'colour' is missing or unknown"),
        (lambda c: c.update(latent=7), "does not describe a model"),
        (lambda c: c.update(min_frames=0), "out of range"),
        (lambda c: c.update(name="../walker"), r"'\.\./walker' cannot be part of a file's name"),
        (lambda c: c.update(max_frames=10**9), "out of range"),
        (lambda c: c.update(latent=[1, 32]), "'vae' has tokens 16, the latent 1"),
        (lambda c: c.update(models=[]), "does not describe a model"),
        (lambda c: c["guidance"].pop("pcm-2"), "does not describe a model"),
        (lambda c: c["models"].update({"pcm-x": c["models"]["pcm-1"]}), "does not describe a model"),
    ],
)
def test_absurd_descriptions_are_refused(folder, change, message):
    rewrite(folder, change)
    with pytest.raises(FormatError, match=message):
        ModelFolder(folder, ClipConfig)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda c: c["models"]["vae"].update(kind="os.system"), "unknown model kind"),
        (lambda c: c["models"]["vae"]["config"].update(width=10**12), "outside"),
        (lambda c: c["models"]["vae"]["config"].update(width=32), "does not fit the architecture"),
    ],
)
def test_absurd_architectures_are_refused(folder, change, message):
    rewrite(folder, change)
    with pytest.raises(FormatError, match=message):
        ModelFolder(folder, ClipConfig).module("vae")


def test_a_manifest_cannot_point_outside(folder):
    manifest = json.loads((folder / "manifest.json").read_text())
    manifest["files"]["../secret"] = {"sha256": "0" * 64, "bytes": 1}
    (folder / "manifest.json").write_text(json.dumps(manifest))
    with pytest.raises(FormatError, match="is not a manifest"):
        ModelFolder(folder, ClipConfig)


def test_unknown_models_are_named(tmp_path):
    with pytest.raises(InputError, match="unknown model 'nothing'"):
        find_folder("nothing")
    with pytest.raises(FormatError, match=r"is no model folder: it has no manifest\.json"):
        ModelFolder.open(tmp_path, ClipConfig)


def test_saving_replaces_and_leaves_nothing_else(folder):
    before = ModelFolder(folder, ClipConfig).tensors("pcm-1.safetensors")
    tiny_bundle(folder, seed=1)
    after = ModelFolder(folder, ClipConfig).tensors("pcm-1.safetensors")
    assert any(not torch.equal(before[name], after[name]) for name in before)
    assert [p.name for p in folder.parent.iterdir()] == ["tiny"]
    assert {p.name for p in folder.iterdir()} == {*ModelFolder(folder, ClipConfig).files, "manifest.json"}


def test_a_failed_save_leaves_the_old_folder(folder):
    module = LengthPredictorConfig(text_dim=8, width=8).build()
    with torch.no_grad():
        module.layers[1].weight[0, 0] = 1e6
    with pytest.raises(ValueError, match="half precision"):
        save_model(folder, ClipConfig(name="tiny"), {"length": module}, BARE, [], torch.zeros(0, 384))
    ModelFolder(folder, ClipConfig).verify()
    assert [p.name for p in folder.parent.iterdir()] == ["tiny"]


@pytest.mark.parametrize("inside", [None, "new_joint_vecs/000000.npy"])
def test_what_is_no_model_folder_is_never_replaced(tmp_path, inside):
    path = tmp_path / "HumanML3D"
    kept = path / inside if inside else path
    kept.parent.mkdir(parents=True, exist_ok=True)
    kept.write_text("hours of work")
    with pytest.raises(InputError, match="HumanML3D is there already and is no model folder"):
        write_whole(path, {"config.json": b"{}"})
    assert [path.name for path in tmp_path.iterdir()] == ["HumanML3D"]
    assert kept.read_text() == "hours of work"


def test_an_empty_folder_may_be_filled(tmp_path):
    write_whole(tmp_path / "new", {"config.json": b"{}"})
    (tmp_path / "empty").mkdir()
    write_whole(tmp_path / "empty", {"config.json": b"{}"})
    assert (tmp_path / "empty/config.json").read_bytes() == b"{}"


@pytest.mark.parametrize(("broken_off", "raised"), [(KeyboardInterrupt, KeyboardInterrupt), (OSError, MovesetError)])
def test_a_model_that_could_not_be_replaced_is_there_as_before(tmp_path, monkeypatch, broken_off, raised):
    model, rename = tmp_path / "model", Path.rename
    write_whole(model, {"config.json": b"old"})

    def broken(self, target):
        if target == model and self.name != ".old":
            raise broken_off
        return rename(self, target)

    monkeypatch.setattr(Path, "rename", broken)
    with pytest.raises(raised):
        write_whole(model, {"config.json": b"new"})
    assert (model / "config.json").read_bytes() == b"old"
    assert [path.name for path in tmp_path.iterdir()] == ["model"]
