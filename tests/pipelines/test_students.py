"""Students that a model folder keeps as differences from their teacher."""

import hashlib
import json
import shutil

import pytest
import torch

from moveset.errors import FormatError, InputError
from moveset.models.token_denoiser import TokenDenoiserConfig
from moveset.pipelines.model_config import ClipConfig
from moveset.pipelines.model_folder import ModelFolder, save_model
from tests.conditions import condition_of

SIZES = {"token_dim": 8, "text_dim": 64, "width": 96, "heads": 2, "feed_forward": 384, "positions": 64}
SIZES |= {"layers": 3, "time_waves": 64, "guidance_waves": 4}
GUIDANCE = {"teacher": 2.0, "pcm-1": 2.0, "pcm-2": 2.0}

BARE = {name: torch.zeros(1) for name in ClipConfig.statistics}  # which nothing here asks for


def networks():
    """A teacher, and students that went a twentieth of its size away from it."""
    with torch.random.fork_rng(devices=[]), torch.no_grad():
        torch.manual_seed(0)
        teacher = TokenDenoiserConfig(**SIZES).build()
        students = {name: teacher.student() for name in ("pcm-1", "pcm-2")}
        for student in students.values():
            for p in student.parameters():
                p += 0.05 * p.abs().mean() * torch.randn_like(p)
    # The students stand first: the order of the networks does not matter.
    return {**students, "teacher": teacher}


def save(path, bases, modules=None):
    config = ClipConfig(name="tiny", guidance=GUIDANCE, latent=(16, SIZES["token_dim"]))
    return save_model(path, config, modules or networks(), BARE, ["a"], torch.ones(1, 8), bases)


BASES = {"pcm-1": "teacher", "pcm-2": "teacher"}


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    return save(tmp_path_factory.mktemp("students") / "whole", None)


@pytest.fixture
def folder(tmp_path):
    return save(tmp_path / "tiny", BASES)


def reseal(folder, file, data):
    """Replace a file and its manifest entry."""
    (folder / file).write_bytes(data)
    manifest = json.loads((folder / "manifest.json").read_text())
    manifest["files"][file] = {"sha256": hashlib.sha256(data).hexdigest(), "bytes": len(data)}
    (folder / "manifest.json").write_text(json.dumps(manifest))


def described(folder, change):
    config = json.loads((folder / "config.json").read_text())
    change(config["models"])
    reseal(folder, "config.json", json.dumps(config).encode())


def output(network):
    g = torch.Generator().manual_seed(4)
    z, tokens = torch.randn(8, 4, 8, generator=g), torch.randn(8, 5, 64, generator=g)
    t = torch.randint(0, 1000, (8,), generator=g)
    with torch.no_grad():
        return network.eval()(z, t, condition_of(tokens, scale=torch.full((8,), 2.0)))


def test_a_student_computes_the_same(folder):
    bundle = ModelFolder(folder, ClipConfig)
    for name in ("pcm-1", "pcm-2"):
        wanted, found = output(networks()[name]), output(bundle.module(name))
        # Above: well below a percent. Below: it did come back from eight bits, not from the weights themselves.
        assert 1e-5 < float((found - wanted).norm() / wanted.norm()) < 4e-3


def test_a_student_takes_half_the_room(folder, whole):
    sizes = {name: ModelFolder(path, ClipConfig).files for name, path in (("half", folder), ("whole", whole))}
    for name in ("pcm-1", "pcm-2"):
        file = f"{name}.safetensors"
        assert sizes["half"][file][1] < 0.6 * sizes["whole"][file][1]
    assert sizes["half"]["teacher.safetensors"] == sizes["whole"]["teacher.safetensors"]


def test_every_save_and_load_gives_the_same_bits(folder, tmp_path):
    again = save(tmp_path / "again", BASES)
    assert {p.name: p.read_bytes() for p in folder.iterdir()} == {p.name: p.read_bytes() for p in again.iterdir()}
    assert torch.equal(
        output(ModelFolder(folder, ClipConfig).module("pcm-1")), output(ModelFolder(again, ClipConfig).module("pcm-1"))
    )


def test_only_a_student_and_its_base_are_read(folder):
    (folder / "pcm-2.safetensors").write_bytes(b"not read")
    ModelFolder(folder, ClipConfig).module("pcm-1")
    ModelFolder(folder, ClipConfig).module("teacher")
    assert ModelFolder(folder, ClipConfig).config.models["teacher"].base is None
    assert ModelFolder(folder, ClipConfig).config.models["pcm-1"].base == "teacher"


def forget(folder):
    manifest = json.loads((folder / "manifest.json").read_text())
    del manifest["files"]["teacher.safetensors"]
    (folder / "manifest.json").write_text(json.dumps(manifest))


def damage(folder):
    data = (folder / "teacher.safetensors").read_bytes()
    (folder / "teacher.safetensors").write_bytes(data[:-1] + bytes([data[-1] ^ 1]))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda folder: (folder / "teacher.safetensors").unlink(), r"cannot read .*teacher\.safetensors"),
        (forget, r"no teacher\.safetensors in its manifest"),
        (damage, r"teacher\.safetensors is damaged"),
    ],
)
def test_a_base_that_is_not_there_is_named(folder, change, message):
    change(folder)
    with pytest.raises(InputError, match=message):
        ModelFolder(folder, ClipConfig).module("pcm-1")


def test_another_teacher_is_refused(folder, tmp_path):
    """Whole in itself and of the right shape, but not the one that the differences were taken from."""
    modules = networks()
    with torch.no_grad():
        modules["teacher"].latent_out.bias += 1
    other = save(tmp_path / "other", None, modules)
    reseal(folder, "teacher.safetensors", (other / "teacher.safetensors").read_bytes())
    bundle = ModelFolder(folder, ClipConfig)
    bundle.module("teacher")
    with pytest.raises(FormatError, match=r"pcm-1\.safetensors holds differences from another teacher\.safetensors"):
        bundle.module("pcm-1")


def test_differences_without_a_base_are_refused(folder):
    described(folder, lambda models: models["pcm-1"].update(base=None))
    with pytest.raises(FormatError, match="does not fit the architecture"):
        ModelFolder(folder, ClipConfig).module("pcm-1")


@pytest.mark.parametrize("base", ["nobody", "pcm-1", "pcm-2", 7, ["teacher"]])
def test_absurd_bases_are_refused(folder, base):
    described(folder, lambda models: models["pcm-1"].update(base=base))
    with pytest.raises(FormatError, match="does not describe a model"):
        ModelFolder(folder, ClipConfig)


@pytest.mark.parametrize(
    "bases", [{"pcm-1": "nobody"}, {"nobody": "teacher"}, {"pcm-1": "pcm-1"}, {"pcm-1": "pcm-2", "pcm-2": "teacher"}]
)
def test_a_base_must_be_whole(tmp_path, bases):
    with pytest.raises(ValueError, match="cannot be stored as differences"):
        save(tmp_path / "tiny", bases)
    assert list(tmp_path.iterdir()) == []


def test_folders_from_before_differences_are_read(whole, tmp_path):
    folder = shutil.copytree(whole, tmp_path / "old")

    def older(models):
        for spec in models.values():
            del spec["base"], spec["base_sha256"]

    described(folder, older)
    assert torch.equal(
        output(ModelFolder(folder, ClipConfig).module("pcm-1")), output(ModelFolder(whole, ClipConfig).module("pcm-1"))
    )
