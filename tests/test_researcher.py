"""What a researcher does with a HumanML3D or KIT-ML folder: train all of it, export, judge, make tables and files."""

import json
from pathlib import Path

import numpy as np
import pytest

import moveset
from moveset.cli.__main__ import main
from moveset.data.humanml3d import HUMANML3D, KIT
from moveset.motion.features import get_codec
from tests.synthetic import synthetic_corpus
from tests.tiny_run import briefly_validated

# A busy machine takes some minutes for all of it.
pytestmark = pytest.mark.timeout(900)

MODELS = ("motionpcm-tiny", "rdm-tiny", "md-7-tiny")
STAGES = (
    "vae", "decoder", "teacher", "length", "sides", "lcm-1", "pcm-", "rdm-7", "md-7", "rdm-student", "movement",
    "evaluator", "export t2m", *(f"export {model}" for model in MODELS),
)  # fmt: skip


@pytest.fixture(scope="module")
def corpus(tmp_path_factory):
    """As many takes to be judged by as a group of R-precision has, and few to learn from."""
    return synthetic_corpus(tmp_path_factory.mktemp("corpus") / "corpus.safetensors", clips=62, held_out=38)


@pytest.fixture(scope="module")
def made():
    """What ``trained`` has made, by layout: its parameters alternate from test to test."""
    return {}


@pytest.fixture(params=[(HUMANML3D, "humanml3d", ("motiondiffuse", "dip")), (KIT, "kit-ml", ())], ids=["hml", "kit"])
def trained(request, corpus, made, tmp_path_factory):
    """A folder as published ones are, and the models of every stage trained on it."""
    layout, name, more = request.param
    if name not in made:
        made[name] = tmp_path_factory.mktemp(name)
        with pytest.MonkeyPatch.context() as patch, briefly_validated():
            patch.chdir(made[name])
            assert main(["data", "export", str(corpus), "data", "--format", name]) == 0
            stages = (*STAGES, *more, *(f"export {model}" for model in more))
            given = ["--recipe", "tiny", "--corpus", "data", "--out", ".", "--device", "cpu"]
            assert main(["train", "all", *given, *(word for stage in stages for word in ("--only", stage))]) == 0
    return layout, made[name], [f"{model}-tiny" for model in more]


def test_both_papers_tables_come_of_a_folder(trained, monkeypatch, capsys):
    _, place, baselines = trained
    monkeypatch.chdir(place)
    rows = {"motionpcm": ("real", "pcm-1"), "rdm": ("real", "rdm-pcm-1")}
    if baselines:
        rows["motionpcm"] += ("vae", "teacher", "lcm-1")
        rows["rdm"] += ("md-7", "rdm-7", "dip", "motiondiffuse")
    models = [str(Path("models") / model) for model in (*MODELS, *baselines)]
    for suite, keys in rows.items():
        given = ["--data", "data", "--evaluator", "models/t2m-tiny", "--repeats", "1", "--multimodality", "0"]
        given += ["--items", "34", "--processes", "1", "--suite", suite]
        assert main(["evaluate", *models, *given, *(word for key in keys for word in ("--row", key))]) == 0
        for key in keys:
            result = json.loads(Path(f"results/{suite}/{key}.json").read_text())
            assert {"r1", "r3", "fid", "mm_dist"} <= set(result["metrics"]), key
            assert result["data"]["name"] == "data"
        assert "| Real |" in capsys.readouterr().out


@pytest.mark.parametrize("verb", ["generate", "stream"])
def test_motions_leave_as_files(trained, tmp_path, monkeypatch, verb):
    layout, place, _ = trained
    monkeypatch.chdir(place)
    model, length = (MODELS[0], "--seconds") if verb == "generate" else (MODELS[1], "--total")
    files = [tmp_path / f"made.{ending}" for ending in ("npy", "bvh", "glb")[verb == "stream" :]]
    given = ["--model", f"models/{model}", length, "4", *(x for file in files for x in ("-o", str(file)))]
    assert main([verb, "a person walks", *given]) == 0
    order = get_codec(layout.codec).skeleton.joints
    made = []
    for file in files:
        if file.suffix == ".npy":
            made.append(np.load(file))
        else:
            read = moveset.load(file)
            assert read.fps == pytest.approx(layout.fps)
            made.append(read.joints[:, [read.skeleton.index(name) for name in order]].numpy())
    assert made[0].shape[1:] == (len(order), 3)
    assert np.isfinite(made[0]).all()
    # Rotations found for the positions give these again.
    assert all(np.abs(other - made[0]).max() < 2e-3 for other in made[1:])
