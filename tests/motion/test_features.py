"""Codecs by name, and the normaliser's statistics."""

import pytest
import torch

from moveset.errors import InputError
from moveset.motion.features import BIASED_GROUPS, CODECS, Normalizer, get_codec
from tests.motions import wander

GROUPS = {
    "root_yaw": slice(0, 1), "root_velocity": slice(1, 3), "root_height": slice(3, 4), "positions": slice(4, 10),
    "rotations": slice(10, 12), "velocities": slice(12, 13), "contacts": slice(13, 15),
}  # fmt: skip


def clips(seed=0):
    generator = torch.Generator().manual_seed(seed)
    scale = torch.linspace(0.01, 5.0, 15)
    return [torch.randn(n, 15, generator=generator) * scale + 3.0 for n in (7, 30, 1, 12)]


@pytest.mark.parametrize(("name", "dim", "frames"), [("hml", 263, 20.0), ("kit", 251, 12.5), ("native", 269, 20.0)])
def test_codecs_by_name(name, dim, frames):
    codec = get_codec(name)
    assert (codec.name, codec.dim, codec.fps) == (name, dim, frames)
    assert get_codec(name) is codec
    columns = [c for part in codec.groups.values() for c in range(dim)[part]]
    assert sorted(columns) == list(range(dim))
    assert set(BIASED_GROUPS) <= set(codec.groups)
    features = codec.encode(wander(9, 0, codec.skeleton, codec.fps))
    assert features.dtype == torch.float32
    assert features.shape == (len(features), dim)
    joints = codec.joints(features)
    assert joints.shape == (len(features), len(codec.skeleton), 3)
    motion = codec.decode(features)
    assert (len(motion), motion.fps, motion.skeleton) == (len(features), codec.fps, codec.skeleton)


def test_another_name_is_refused():
    with pytest.raises(InputError, match=f"choose one of {', '.join(CODECS)}"):
        get_codec("smpl")


def test_statistics_are_the_mean_and_the_groups_mean_deviation():
    data = torch.cat(clips()).double()
    normalizer = Normalizer.fit(clips(), GROUPS)
    torch.testing.assert_close(normalizer.mean, data.mean(0).float())
    plain = data.std(0, correction=0)
    for part in GROUPS.values():
        expected = plain[part].mean().expand(len(plain[part])).float()
        torch.testing.assert_close(normalizer.std[part], expected)
    assert normalizer.mean.dtype == normalizer.std.dtype == torch.float32


def test_one_pass_holds_far_from_zero():
    """Root heights in millimetres: large values, small deviation."""
    far = [clip.double() + 1e6 for clip in clips()]
    exact = torch.cat(far).double().std(0, correction=0)
    torch.testing.assert_close(Normalizer.fit(far, GROUPS).std[:1], exact[:1].float(), rtol=1e-4, atol=0)


def test_the_bias_divides_root_and_contacts_once():
    plain = Normalizer.fit(clips(), GROUPS)
    biased = plain.biased(GROUPS, 5.0)
    ratio = plain.std / biased.std
    torch.testing.assert_close(ratio, torch.tensor([5.0] * 4 + [1.0] * 9 + [5.0] * 2))
    torch.testing.assert_close(plain.biased(GROUPS, 5.0).biased(GROUPS, 5.0).std, plain.biased(GROUPS, 25.0).std)
    assert torch.equal(plain.mean, biased.mean)


def test_normalising_and_back():
    normalizer = Normalizer.fit(clips(), GROUPS)
    x = torch.stack([clips(1)[1], clips(2)[1]])
    z = normalizer.normalize(x)
    assert z.shape == x.shape
    torch.testing.assert_close(normalizer.denormalize(z), x, atol=1e-5, rtol=1e-5)
    everything = normalizer.normalize(torch.cat(clips()))
    assert everything.mean(0).abs().max() < 1e-4
    assert everything[:, :1].std(correction=0) == pytest.approx(1.0, abs=1e-4)


def test_a_group_that_never_varies_is_only_centred():
    still = [clip.clone() for clip in clips()]
    for clip in still:
        clip[:, 13:15] = 1.0
    normalizer = Normalizer.fit(still, GROUPS)
    assert normalizer.std[13:].tolist() == [1.0, 1.0]
    assert normalizer.normalize(still[0])[:, 13:].abs().max() == 0.0


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: Normalizer.fit([], GROUPS), "empty"),
        (lambda: Normalizer.fit([torch.zeros(3, 16)], GROUPS), "16 columns"),
        (lambda: Normalizer.fit([torch.ones(3, 15)], GROUPS).biased(GROUPS, 0.0), "above 0"),
        (lambda: Normalizer(torch.zeros(3), torch.tensor([1.0, 0.0, 1.0])), "above 0"),
        (lambda: Normalizer(torch.zeros(3), torch.ones(4)), r"\(3,\) and \(4,\)"),
        (lambda: Normalizer(torch.full((3,), torch.nan), torch.ones(3)), "finite"),
    ],
)
def test_bad_statistics_are_named(call, message):
    with pytest.raises(InputError, match=message):
        call()
