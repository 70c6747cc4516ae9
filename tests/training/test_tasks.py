import subprocess
import sys
from contextlib import nullcontext
from dataclasses import dataclass, field, replace
from pathlib import Path

import pytest

from moveset.errors import InputError
from moveset.evaluation.suites import get_suite
from moveset.recipes import small
from moveset.training.engine import run
from moveset.training.pipeline import Place
from moveset.training.tasks import (
    TASKS,
    VARIANTS,
    Sources,
    load_exports,
    load_recipe,
    load_recipes,
    task_maker,
    with_settings,
)


@dataclass(frozen=True)
class Model:
    layers: int = 4
    dropout: float = 0.1
    widths: tuple[int, ...] = (8, 8)


@dataclass(frozen=True)
class Config:
    lr: float = 1e-3
    augment: bool = True
    name: str = "x"
    kind: str = field(default="made", init=False)
    corpus: Path = Path("a")
    model: Model = field(default_factory=Model)
    other: Model | None = field(default_factory=Model)
    nothing: Model | None = None


def test_settings_replace_fields_by_their_types():
    got = with_settings(
        Config(), ["lr=2", "augment=false", "name=y", "corpus=b/c", "model.layers=9", "model.widths=[1,2]"]
    )
    assert got == Config(2.0, False, "y", Path("b/c"), Model(9, 0.1, (1, 2)))
    assert isinstance(got.lr, float)
    assert with_settings(Config(), ["other.layers=2"]).other == Model(2)
    assert with_settings(Config(), ["other=null"]).other is None


@pytest.mark.parametrize(
    ("setting", "message"),
    [
        ("lr", "not of the form NAME=VALUE"),
        ("lrr=1", "did you mean 'lr'"),
        ("model.layer=1", "did you mean 'layers'"),
        ("kind=y", "no setting 'kind'; choose one of lr, augment, name, corpus, model, other, nothing$"),
        ("lr=NaN", "is no finite number; give one, such as 0.001"),
        ("lr=fast", "is str but must be float"),
        ("augment=1", "is int but must be bool"),
        ("lr=true", "is bool but must be float"),
        ("lr.x=1", "float has no setting 'x'"),
        ("model=3", "must be Model"),
        ("model=null", "is NoneType but must be Model"),
        ("model.widths=[1]", r"has 1 values but must have 2, such as \[8, 8\]"),
        ('model.widths=[1,"b"]', "is str but must be int"),
        ("nothing=3", "there is none here, and a setting cannot make one"),
    ],
)
def test_a_wrong_setting_is_one_sentence(setting, message):
    with pytest.raises(InputError, match=message):
        with_settings(Config(), [setting])


@pytest.mark.parametrize(
    ("what", "setting", "message"),
    [
        ("teacher", "weight=x0", "weight 'x0' is not one of eps, v"),
        ("vae", "loss=publishd", "loss 'publishd' is not one of auto, kinematic, published"),
        ("evaluator", "negatives=none", "negatives 'none' is not one of roll, all"),
        ("teacher", "condition_dropout=10", "condition_dropout = 10.0 is outside 0"),
        ("pcm-1", "mismatched_text=-0.5", "mismatched_text = -0.5 is outside 0"),
        ("rdm-student", "sides=7", "sides = 7.0 is outside 0"),
        ("movement", "window=30", "window modulo 4 = 2"),
        ("evaluator", "batch=1", "batch = 1 is outside 2"),
        ("evaluator", "max_words=0", "max_words=0 trains nothing"),
        ("movement", "window=0", "window=0 trains nothing"),
        ("dip", "levels=0", "levels=0 trains nothing"),
        ("rdm-7", "cutting.horizon=0", "cutting.horizon 0"),
    ],
)
def test_a_name_is_a_known_one_and_a_share_within_the_whole(what, setting, message):
    with pytest.raises(InputError, match=message):
        with_settings(load_recipe("tiny", what).task, [setting])


def test_the_command_does_not_import_torch_before_it_has_set_the_wait_policy():
    code = "import sys, moveset.cli.__main__, moveset.cli.train; sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code]).returncode == 0


def test_unknown_names_are_refused():
    nowhere = Sources(corpus=Path(), vae=Path(), teacher=Path(), cache=Path())
    with pytest.raises(InputError, match=f"choose one of {', '.join(TASKS)}"):
        task_maker("gan", None, nowhere)
    for setting, said in (
        ("batch=0", "batch=0 trains nothing"),
        ("lr=0", "lr=0 trains"),
        ("lr=-1", "lr = -1.0 is below 0"),
    ):
        with pytest.raises(InputError, match=said):
            task_maker("vae", with_settings(load_recipe("tiny", "vae").task, [setting]), nowhere)
    with pytest.raises(InputError, match="no recipe 'huge'"):
        load_recipe("huge", "vae")


@pytest.mark.parametrize(
    ("what", "setting", "message"),
    [
        ("lcm-1", "adversarial=0.2", "'adversarial=0.2' is no setting of 'lcm-1'; leave it out"),
        ("rdm-student", "frames=9", "'frames=9' is no setting of 'rdm-student': there it is 28, by what it stands on"),
        ("evaluator", "feat_bias=3.5", "no setting of 'evaluator': there it is"),
        ("length", "model.text_dim=9", "no setting of 'length': there it is 384"),
        ("length", "lr=0.5", ""),
        ("vae", "codec=auto", ""),
    ],
)
def test_settings_that_would_do_nothing_are_refused(tiny_run, tmp_path, what, setting, message):
    recipe, sources = load_recipe("tiny", what), Place(data=tiny_run.corpus, out=tiny_run.folder).sources(what)
    maker = task_maker(what, with_settings(recipe.task, [setting]), sources, [setting])
    engine = replace(recipe.engine, steps=1, validate_every=0)
    with pytest.raises(InputError, match=message) if message else nullcontext():
        run(maker, engine, tmp_path / "run")


@pytest.mark.parametrize("recipe", ["small", "paper"])
def test_variants_differ_from_their_originals_in_one_setting(recipe):
    recipes = load_recipes(recipe)
    for name in VARIANTS.keys() & recipes.keys():
        original, setting = VARIANTS[name]
        changed = {k for k, v in vars(recipes[name].task).items() if v != getattr(recipes[original].task, k)}
        assert changed == {setting.partition("=")[0]}
        assert recipes[name].engine == recipes[original].engine


@pytest.mark.parametrize(
    ("recipe", "ours"), [("small", set()), ("paper", {"rdm-pcm-1", "rdm-pcm-2", "whole-sentences"})]
)
def test_every_row_of_both_papers_has_a_stage(recipe, ours):
    """Students of streams are ours, and not published."""
    made = {
        f"{export.name.removesuffix(recipe)}/{network}" for export in load_exports(recipe) for network in export.runs
    }
    rows = [row for name in ("motionpcm", "rdm") for row in get_suite(name).rows if row.network]
    assert {row.key for row in rows if f"{row.model.removesuffix('small')}/{row.network}" not in made} == ours


def test_what_is_compared_with_streams_is_shown_as_many_frames():
    recipes = {name: load_recipe("small", name) for name in (*(f"rdm-{n}" for n in (1, 4, 7, 14)), "md-4", "md-7",
               "light-rdm-1", "motiondiffuse", "dip")}  # fmt: skip
    seen = {}
    for name, recipe in recipes.items():
        frames = recipe.task.model.frames if name == "dip" else recipe.task.grid.frames
        seen[name] = recipe.engine.steps * recipe.task.batch * frames
    assert max(seen.values()) == seen["rdm-7"] == seen["md-7"] == small.STREAMS * 64 * 28
    assert min(seen.values()) > 0.999 * seen["rdm-7"]
