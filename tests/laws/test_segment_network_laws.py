"""What every denoiser of segments promises, whatever its architecture: add it to the list and it must keep them too."""

import json
from dataclasses import replace

import pytest
import torch
from torch import nn

from moveset.errors import FormatError, InputError
from moveset.models.dip_decoder import DipDecoderConfig
from moveset.models.flow import FlowConfig
from moveset.models.light_t2m import LightT2MConfig
from moveset.models.registry import build_model, describe
from moveset.models.segment_denoiser import SegmentDenoiserConfig
from moveset.models.segment_transformer import SegmentTransformerConfig
from moveset.models.token_vae import TokenVAEConfig
from tests.conditions import awake, call

TRANSFORMER = SegmentTransformerConfig(features=5, frames=8, text_dim=6, width=16, heads=2, hidden=24, blocks=2)
VOLUME = SegmentDenoiserConfig(
    features=5, frames=8, text_dim=6, width=16, layers=2, heads=2, feed_forward=24, conditioning=20, text_width=12,
    text_layers=1, text_heads=2, text_feed_forward=16, prev_width=10, guidance_waves=8,
)  # fmt: skip
CROSS = replace(VOLUME, prev="xattn", max_index=2, boundary=2)
LIGHT = LightT2MConfig(features=5, frames=24, text_dim=6, width=12, stages=2, patch=4, groups=3, states=4, rank=2)
DIP = DipDecoderConfig(features=5, prefix=8, frames=8, text_dim=6, width=12, layers=2, heads=2, feed_forward=16)
NETWORKS = {
    "transformer": TRANSFORMER,
    "guided": replace(TRANSFORMER, guided=True),
    "turned": replace(TRANSFORMER, heading_change=True),
    "volume": VOLUME,
    "cross": CROSS,
    "softmax": replace(CROSS, attention="softmax"),
    "read-padding": replace(CROSS, read_padding=True),
    "light": LIGHT,
    "light-mean": replace(LIGHT, pool="mean"),
    "dip": DIP,
}
STUDENTS = ("transformer", "turned", "volume", "cross")
LENGTHS = torch.tensor([8, 5, 1, 6])


@pytest.fixture(params=NETWORKS)
def name(request):
    return request.param


def inputs(name):
    """All that a network is given, of four rows."""
    g = torch.Generator().manual_seed(1)
    x, prev, tokens = (torch.randn(4, *shape, generator=g) for shape in ((8, 5), (8, 5), (7, 6)))
    index = torch.zeros(4, dtype=torch.long) if name.startswith("light") else torch.tensor([0, 0, 1, 5])
    given = {
        "x_BnD": x, "t_B": torch.tensor([1, 3, 500, 1000]), "prev_BnD": prev, "prev_t_B": torch.tensor([9, 0, 0, 700]),
        "index_B": index, "tokens_BLC": tokens, "mask_BL": torch.arange(7) < torch.tensor([7, 4, 1, 5])[:, None],
    }  # fmt: skip
    if name == "guided":
        given["w_B"] = torch.arange(4.0)
    if name == "turned":
        given["turned_B"] = torch.tensor([0.0, 1.5, float("nan"), -1.5])
    return given


def close(one, other, rounding=0.0):
    torch.testing.assert_close(one, other, rtol=1e-4, atol=max(1e-5, 4 * rounding))


def rounding_of(model, given):
    """How far outputs go if the last bit of an input changes: processors add up batches in orders of their own."""
    whole, bit = call(model, **given).detach(), 1 + torch.finfo(torch.float32).eps
    floats = [key for key, value in given.items() if value.is_floating_point()]
    moved = (call(model, **{**given, key: given[key] * bit}).detach() for key in floats)
    return max(float((made - whole).abs().max()) for made in moved)


def test_gradients_reach_every_parameter(name):
    model, given = awake(NETWORKS[name]), inputs(name)
    call(model, **given).square().mean().backward()
    # A key's bias moves all keys alike, and the softmax over them does not see it.
    silent = [n for n, p in model.named_parameters() if p.grad is None or not p.grad.any()]
    assert [parameter for parameter in silent if not parameter.endswith(".keys.bias")] == []


def test_taps_are_frames_of_every_block_and_change_nothing(name):
    if name == "dip":
        pytest.skip("nothing is distilled from it")
    model, given, taps = awake(NETWORKS[name]), inputs(name), []
    made = call(model, **given, taps=taps)
    assert made.shape == given["x_BnD"].shape
    assert torch.equal(made, call(model, **given))
    assert len(taps) >= 2
    assert {tap.shape for tap in taps} == {(4, 8, model.config.width)}
    assert not torch.equal(*taps[:2])


def test_rows_do_not_know_of_each_other_and_may_be_prepared(name):
    model, given = awake(NETWORKS[name]), inputs(name)
    whole = call(model, **given)
    assert torch.equal(call(model, **given, prepare=True), whole)
    rounding = rounding_of(model, given)
    assert rounding < 1e-4  # what a row knew of another would show
    for row in range(4):
        alone = call(model, **{key: value[row : row + 1] for key, value in given.items()})
        close(alone, whole[row : row + 1], rounding)


@pytest.mark.parametrize("name", [name for name in NETWORKS if name not in ("volume", "light", "light-mean", "dip")])
def test_a_first_segment_has_no_past_and_later_ones_read_its_frames_and_its_level(name):
    model, given = awake(NETWORKS[name]), inputs(name)
    prev, later = given["prev_BnD"], given["index_B"] > 0
    expected, transformer = call(model, **given), isinstance(model.config, SegmentTransformerConfig)
    # A transformer reads the level of whatever it is told, so a first segment's past is told clean.
    louder = given["prev_t_B"] + 200 * (later if transformer else 1)
    for changed in ({"prev_BnD": prev + 1}, {"prev_t_B": louder}):
        made = call(model, **{**given, **changed})
        assert torch.equal(made[~later], expected[~later])
        assert ((made - expected)[later].abs().amax(dim=(1, 2)) > 1e-4).all()
    filler = 1e3 if transformer else float("nan")
    torn = call(model, **{**given, "prev_BnD": prev.masked_fill(~later[:, None, None], filler)})
    assert torch.equal(torn, expected)


def test_padded_frames_do_not_matter(name):
    model, given = awake(NETWORKS[name]), inputs(name)
    mask = torch.arange(8) < LENGTHS[:, None]
    expected = call(model, **given, mask_Bn=mask)
    filler = 50.0 if model.config.__class__ is SegmentTransformerConfig else float("nan")
    torn = given["x_BnD"].masked_fill(~mask[..., None], filler)
    close(call(model, **{**given, "x_BnD": torn}, mask_Bn=mask)[mask], expected[mask])
    close(call(model, **given, mask_Bn=torch.ones_like(mask)), call(model, **given))
    if filler == 50.0 or name == "dip":
        return  # their segments have one length
    for row, frames in enumerate(LENGTHS):
        alone = {key: value[row : row + 1] for key, value in given.items()} | {
            "x_BnD": given["x_BnD"][row, None, :frames]
        }
        close(call(model, **alone), expected[row, None, :frames])


def test_padded_text_does_not_matter_and_text_does(name):
    model, given = awake(NETWORKS[name]), inputs(name)
    tokens, mask = given["tokens_BLC"], given["mask_BL"]
    expected = call(model, **given)
    assert not torch.allclose(call(model, **{**given, "tokens_BLC": tokens.roll(1, 0)})[0], expected[0], atol=1e-4)
    if name == "read-padding":
        moved = call(model, **{**given, "tokens_BLC": tokens + 1.0 * ~mask[..., None]})
        close(moved[0], expected[0])  # this prompt has no padding
        assert not torch.allclose(moved[1], expected[1], atol=1e-4)
        return
    filler = 50.0 if model.config.__class__ is SegmentTransformerConfig else float("nan")
    close(call(model, **{**given, "tokens_BLC": tokens.masked_fill(~mask[..., None], filler)}), expected)
    one = {key: value[1:2] for key, value in given.items()}
    cut = call(model, **{**one, "tokens_BLC": tokens[1:2, :4], "mask_BL": mask[1:2, :4]})
    close(cut, expected[1:2], rounding_of(model, given))
    empty = {**given, "mask_BL": mask & torch.tensor([True, True, True, False])[:, None]}
    close(call(model, **empty)[:3], expected[:3])
    assert torch.isfinite(call(model, **empty)).all()


def test_a_network_is_rebuilt_from_its_description(name):
    model, given = awake(NETWORKS[name]), inputs(name)
    kind, stored = describe(model.config)
    twin = build_model(kind, json.loads(json.dumps(stored))).eval()
    assert twin.config == model.config
    twin.load_state_dict(model.state_dict())
    assert torch.equal(call(twin, **given), call(model, **given))


@pytest.mark.parametrize("name", STUDENTS)
def test_a_fresh_student_is_its_teacher_whatever_the_guidance(name):
    teacher, given = awake(NETWORKS[name]), inputs(name)
    student, expected = teacher.student(), call(teacher, **given)
    assert student.config == replace(teacher.config, guided=True)
    assert not student.training
    for w in (0.0, 7.5):
        assert torch.equal(call(student, **given, w_B=torch.full((4,), w)), expected)
    # ... and not by deafness; nor are its weights the teacher's own.
    for key, parameter in student.named_parameters():
        if key.endswith("guidance.weight"):
            nn.init.normal_(parameter)
    low, high = (call(student, **given, w_B=torch.full((4,), w)) for w in (1.0, 2.0))
    assert not torch.allclose(low, high)
    assert torch.equal(call(teacher, **given), expected)
    if isinstance(teacher.config, SegmentTransformerConfig):
        return
    with pytest.raises(InputError, match="does not take"):
        call(teacher, **given, w_B=torch.ones(4))
    with pytest.raises(InputError, match="needs"):
        call(student, **given)


@pytest.mark.parametrize(
    ("config", "every_wrong"),
    [
        (TRANSFORMER, [{"heads": 3}, {"frames": 1}, {"blocks": 0}, {"features": 0}]),
        (
            VOLUME,
            [
                {"features": 0}, {"width": 15}, {"heads": 3}, {"text_heads": 5}, {"layers": 65}, {"dropout": 1.0},
                {"prev": "concat"}, {"attention": "flash"}, {"prev": "xattn", "max_index": 0}, {"boundary": 1},
                {"boundary": 99, "prev": "xattn", "max_index": 1}, {"max_index": -1},
            ],
        ),
        (LIGHT, [{"features": 0}, {"width": 13}, {"groups": 5}, {"stages": 0}, {"pool": "max"}, {"patch": 65}]),
        (DIP, [{"features": 0}, {"width": 13}, {"heads": 5}, {"layers": 65}, {"frames": 0}, {"dropout": 1.0}]),
        (FlowConfig(), [{"bound": "relu"}, {"log_scale": 0.0}, {"features": 1}, {"max_index": -1}, {"seed": -1}]),
        (TokenVAEConfig(features=7), [{"layers": 4}, {"heads": 3}]),
    ],
    ids=["transformer", "volume", "light", "dip", "flow", "vae"],
)  # fmt: skip
def test_bad_settings_are_one_sentence(config, every_wrong):
    for wrong in every_wrong:
        with pytest.raises(InputError):
            replace(config, **wrong)
        kind, stored = describe(config)
        with pytest.raises(FormatError):
            build_model(kind, stored | wrong)
