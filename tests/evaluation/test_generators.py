"""Whatever makes motion gives joints of the length and frame rate that are asked for, each from its own seed."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from moveset.errors import FormatError, InputError
from moveset.evaluation.generators import Generated, Given, Reconstruction, Wanted, resampled
from moveset.evaluation.motion_files import folder_motions
from moveset.evaluation.run import EvaluationConfig, open_source
from moveset.motion.features import get_codec
from moveset.pipelines.clip_generator import ClipGenerator, clip_method
from moveset.pipelines.model_config import ClipConfig, StreamConfig
from moveset.pipelines.model_folder import ModelFolder
from moveset.pipelines.motion_stream import MotionStream
from moveset.pipelines.request import Request, check_method, check_request
from moveset.pipelines.stream_generator import StreamGenerator, timeline
from moveset.pipelines.stream_settings import check_stream
from moveset.pipelines.text_to_motion import TextToMotion
from tests.evaluation.corpora import motion_folder
from tests.streams import tiny_stream

WALK, BOW = "a person walks forward", "a person bows"


@pytest.fixture(scope="module")
def bundle(tiny):
    return ModelFolder(tiny, ClipConfig)


@pytest.fixture(scope="module")
def streams(tmp_path_factory):
    return ModelFolder(tiny_stream(tmp_path_factory.mktemp("streams") / "tiny-stream"), StreamConfig)


def clips(bundle, solver="pcm", steps=None, **options):
    return Generated(ClipGenerator(bundle, check_method(bundle.config, solver, steps), device="cpu", **options))


@pytest.mark.parametrize(("solver", "steps"), [("pcm", 1), ("pcm", 4), ("lcm", 1), ("teacher", 3)])
def test_clips_are_as_long_as_asked_for(bundle, solver, steps):
    asked = [Wanted(((WALK, frames),), seed) for seed, frames in enumerate((50, 24, 37, 50))]
    ticks = []
    made = clips(bundle, solver, steps).generate(asked, 20.0, ticks.append)
    assert [tuple(joints.shape) for joints in made] == [(n, 22, 3) for n in (50, 24, 37, 50)]
    assert sum(ticks) == 4
    assert not torch.equal(made[0], made[3])


def test_clips_are_what_users_get(bundle):
    made = clips(bundle, batch=1).generate([Wanted(((WALK, 40),), 7)], 20.0)[0]
    users = TextToMotion(bundle, "cpu")(WALK, seconds=2.0, seed=7)
    assert torch.equal(made, users.motion.joints)
    raw = clips(bundle, batch=1, foot_lock=False).generate([Wanted(((WALK, 40),), 7)], 20.0)[0]
    assert torch.equal(raw, users.raw[0].joints)


def test_order_does_not_matter(bundle):
    asked = [Wanted(((prompt, n),), seed) for seed, (prompt, n) in enumerate([(WALK, 50), (BOW, 30), (WALK, 44)])]
    forward = clips(bundle, batch=1).generate(asked, 20.0)
    backward = clips(bundle, batch=1).generate(asked[::-1], 20.0)[::-1]
    assert all(torch.equal(a, b) for a, b in zip(forward, backward, strict=True))


def test_another_frame_rate_covers_the_same_time(bundle):
    made = clips(bundle).generate([Wanted(((WALK, 26),), 0)], 12.5)[0]
    assert len(made) == 26
    same = clips(bundle).generate([Wanted(((WALK, 41),), 0)], 20.0)[0]
    assert torch.allclose(made[::5], same[::8][:6], atol=1e-5)


def test_a_limit_of_the_model_shortens(bundle):
    made = clips(bundle).generate([Wanted(((WALK, bundle.config.max_frames + 9),), 0)], 20.0)[0]
    assert len(made) == bundle.config.max_frames


def test_a_timeline_is_one_motion(bundle):
    made = clips(bundle).generate([Wanted(((WALK, 30), (BOW, 25)), 3)], 20.0)[0]
    assert len(made) == 55
    assert (made[30] - made[29]).norm(dim=-1).max() < 0.3


def test_lcm_takes_more_steps_with_fresh_noise(bundle):
    method = clip_method(bundle.config, "lcm-1", 4, None)
    assert (method.network, method.steps) == ("lcm-1", 4)
    four = Generated(ClipGenerator(bundle, method, device="cpu", batch=2))
    asked = [Wanted(((WALK, 40),), seed) for seed in (1, 2, 1)]
    a, b, again = four.generate(asked, 20.0)
    assert torch.allclose(a, again, atol=1e-5)
    assert not torch.allclose(a, b, atol=1e-3)
    assert not torch.allclose(a, clips(bundle, "lcm").generate(asked[:1], 20.0)[0], atol=1e-3)
    assert four.slug == "tiny-lcm-1-4-steps"


@pytest.mark.parametrize("network", ["lcm", "lcm-1", "pcm-1", "pcm-4"])
def test_a_network_without_steps_takes_its_own(bundle, network):
    method = clip_method(bundle.config, network, None, 1.0)
    assert f"{method.solver}-{method.steps}" == method.network == (network if "-" in network else "lcm-1")


@pytest.mark.parametrize(
    ("network", "steps", "message"),
    [
        ("pcm", 3, "no pcm student for 3 steps"),
        ("pcm-8", None, "choose 1, 2, 4"),
        ("pcm-2", 4, "'pcm-2' does not go with 4 steps"),
        ("lcm", 99, "99 steps are not in 1 to 10"),
        ("teacher", 1, "1 steps are not in 2"),
        ("rdm", None, "unknown network 'rdm'; model 'tiny' has vae, teacher, lcm-1"),
        ("length", None, "unknown network 'length'"),
        ("teacher-5", None, "does not go with"),
        ("lcm-one", 2, "unknown network 'lcm-one'"),
    ],
)
def test_networks_that_are_not_there(bundle, network, steps, message):
    with pytest.raises(InputError, match=message):
        clip_method(bundle.config, network, steps, None)


def test_weights_name_all_that_takes_part(bundle):
    files = {"vae.safetensors", "pcm-1.safetensors", "normalizer.safetensors"}
    assert set(clips(bundle).weights()) == {*files, "vae in config.json", "pcm-1 in config.json"}
    assert Given("real").weights() == {}


def test_reconstructions_keep_their_items(bundle, items):
    draws = items.draw(torch.Generator().manual_seed(0))[:5]
    made = Reconstruction(bundle, device="cpu", batch=2).generate(
        [Wanted(((d.prompt, d.frames),), 0, d) for d in draws], 20.0
    )
    assert [len(joints) for joints in made] == [d.frames for d in draws]
    alone = Reconstruction(bundle, device="cpu", batch=1).generate(
        [Wanted((("", draws[3].frames),), 9, draws[3])], 20.0
    )
    assert torch.allclose(made[3], alone[0], atol=1e-4)


@pytest.mark.parametrize("start", [0, 7])
def test_reconstructions_of_stored_features_lose_no_frame(bundle, items, start):
    whole = items.draw(torch.Generator().manual_seed(0))[0]
    features = get_codec("native").encode(whole.item.motion())[:30]
    item = replace(whole.item, codec="native", rows=30 - start, features=lambda: features, motion=None)
    # A crop has the row after it; the last row of what is stored stands for that.
    for rows in (20, 30 - start):
        draw = replace(whole, item=item, start=start, rows=rows)
        (made,) = Reconstruction(bundle, device="cpu").generate([Wanted((("", draw.frames),), 0, draw)], 20.0)
        assert made.shape == (rows + 1, 22, 3)


def test_real_motion_is_itself(items):
    draws = items.draw(torch.Generator().manual_seed(0))[:3]
    made = Given("real").generate([Wanted(((d.prompt, d.frames),), 0, d) for d in draws], 20.0)
    assert all(torch.equal(joints, d.item.motion().joints) for joints, d in zip(made, draws, strict=True))


@pytest.mark.parametrize(
    ("network", "options"),
    [
        ("pcm-1", {}),
        ("rdm", {}),
        ("rdm", {"lag": 6, "start": 6}),
        ("rdm", {"lag": 6, "start": 6, "past_lag": 1}),
        ("md", {}),
    ],
)
def test_streams_in_batches_are_those_of_users(streams, network, options):
    """Noise is keyed and rows do not see each other, so a batch only differs in the last bits."""
    settings = check_stream(streams.config, network=network, **options).settings
    asked = [Wanted(((WALK, 70),), 5), Wanted(((BOW, 30),), 6), Wanted(((BOW, 84),), 7)]
    made = Generated(StreamGenerator(streams, settings, device="cpu")).generate(asked, 20.0)
    assert [len(joints) for joints in made] == [70, 30, 84]
    request = check_stream(streams.config, BOW, 4.2, network=network, seed=7, **options)
    users = MotionStream(streams, request, device="cpu")
    alone = torch.cat([next(users).motion.joints for _ in range(3)])
    assert torch.allclose(made[2].float(), alone.float(), atol=2e-3)


def test_streams_of_guidance_and_shapes(streams):
    settings = check_stream(streams.config, network="rdm", guidance=2.0, start=2).settings
    asked = [Wanted(((WALK, 84),), 1)]
    triangle = Generated(StreamGenerator(streams, settings, shape="triangle", device="cpu")).generate(asked, 20.0)[0]
    parallelogram = Generated(StreamGenerator(streams, settings, device="cpu")).generate(asked, 20.0)[0]
    assert torch.allclose(triangle[:28], parallelogram[:28], atol=1e-4)
    assert not torch.allclose(triangle[60:], parallelogram[60:], atol=1e-3)


def test_segments_begin_with_the_first_ones_noise_if_asked(streams):
    """Only where they enter at the first step and overlap: later ones always begin with a copy."""

    def made(**how):
        config = EvaluationConfig(model=str(streams.path), network="rdm", settings=tuple(how.items()), device="cpu")
        source = open_source(config)
        return source, source.generate([Wanted(((WALK, 84),), 1)], 20.0)[0]

    (_, own), (source, shared) = made(start=6, lag=1), made(start=6, lag=1, init_noise="shared")
    assert source.describe()["init_noise"] == "shared"
    assert source.slug.endswith("init_noise-shared")
    assert torch.allclose(own[:20], shared[:20], atol=1e-4)
    assert not torch.allclose(own[30:], shared[30:], atol=1e-3)
    for other in ({"start": 3}, {"start": 6, "lag": 6}):
        with pytest.raises(InputError, match="init_noise 'shared' is for start 6"):
            made(**other, init_noise="shared")


def test_prompts_change_at_the_nearest_segment():
    said = timeline(Request((WALK, BOW, WALK), (40, 30, 60), 0), 28, 20.0)
    assert [said.at(k) for k in range(5)] == [WALK, BOW, WALK, WALK, WALK]  # 40 frames are 1.43, 70 are 2.5 segments
    assert [said.behind(k) for k in range(5)] == [0, 0, 0, 1, 2]
    crowded = timeline(Request((WALK, BOW, WALK), (5, 5, 60), 0), 28, 20.0)
    assert [crowded.at(k) for k in range(3)] == [WALK, BOW, WALK]


def test_stages_share_the_frames_of_their_prompt():
    both = "a person walks, then bows"
    said = timeline(Request((both, WALK), (112, 28), 0), 28, 20.0)
    assert [said.at(k) for k in range(5)] == ["a person walks"] * 2 + ["a person bows"] * 2 + [WALK]
    whole = timeline(Request((both, WALK), (112, 28), 0), 28, 20.0, stages=False)
    assert [whole.at(k) for k in range(5)] == [both] * 4 + [WALK]


def test_a_folder_of_joints_with_a_list(tmp_path):
    folder = motion_folder(tmp_path / "motions", 3)
    items = folder_motions(folder, None, 20.0)
    assert [item.name for item in items.items] == ["m-000", "m-001", "m-002"]
    draw = items.draw(torch.Generator())[0]
    assert (draw.frames, len(draw.joints()), len(draw.features())) == (40, 40, 39)
    assert draw.caption == draw.prompt == json.loads((folder / "prompts.jsonl").read_text().splitlines()[0])["prompt"]


def test_a_folder_of_joints_with_text_files(tmp_path):
    folder = motion_folder(tmp_path / "motions", 2)
    (folder / "prompts.jsonl").unlink()
    (folder / "m-000.txt").write_text("\na person walks\nsomeone walks\n")
    (folder / "m-001.txt").write_text("a man bows.#a/DET man/NOUN bow/VERB#0.0#0.0\n")
    first, second = folder_motions(folder, None, 20.0).items
    assert first.captions == ("a person walks",)
    assert second.captions[0].tokens == ("a/DET", "man/NOUN", "bow/VERB")
    assert first.label != second.label


def test_motions_of_generate_with_several_of_a_prompt_and_several_prompts(tmp_path):
    folder = motion_folder(tmp_path / "motions", 4)
    for old, new in zip(sorted(folder.glob("*.npy")), ("m-turn-0", "m-turn-1", "m-0-0", "m-about-turn"), strict=True):
        old.rename(folder / f"{new}.npy")
    lines = (
        '{"name": "turn", "prompt": ["A person turns.", "She bows"]}',
        '{"name": "0", "prompt": "he\u2028sits"}',  # which JSON allows, and no line ends there
        '{"name": "about-turn", "prompt": "they turn"}',
    )
    (folder / "prompts.jsonl").write_text("\n".join(lines))
    said = {item.name: item.captions for item in folder_motions(folder, None, 20.0).items}
    turned = ("A person turns, then she bows",)
    assert said == {"m-turn-0": turned, "m-turn-1": turned, "m-0-0": ("he\u2028sits",), "m-about-turn": ("they turn",)}


def test_prompts_that_differ_by_a_dot_are_one_label(tmp_path):
    folder = motion_folder(tmp_path / "motions", 2)
    (folder / "prompts.jsonl").write_text('{"name": "000", "prompt": "He bows."}\n{"name": "001", "prompt": "he bows"}')
    first, second = folder_motions(folder, None, 20.0).items
    assert first.label == second.label


@pytest.mark.parametrize(
    "prompts",
    [
        ("he jumps 2 times", "he jumps 3 times"),
        ("ein Mann läuft", "ein Mann lauft"),
        ("A: ひとが歩く", "A: ひとが走る"),
    ],
)
def test_prompts_that_differ_in_a_number_or_an_alphabet_are_two_labels(tmp_path, prompts):
    folder = motion_folder(tmp_path / "motions", 2)
    lines = [json.dumps({"name": f"00{k}", "prompt": prompt}) for k, prompt in enumerate(prompts)]
    # As editors on Windows save it: with a mark before the first line.
    (folder / "prompts.jsonl").write_text("\n".join(lines), "utf-8-sig")
    first, second = folder_motions(folder, None, 20.0).items
    assert first.label != second.label
    assert (first.captions, second.captions) == ((prompts[0],), (prompts[1],))


def test_other_frame_rates_are_resampled(tmp_path):
    folder = motion_folder(tmp_path / "motions", 1, frames=61)
    joints = folder_motions(folder, None, 30.0).items[0].joints()
    assert len(joints) == 41
    ramp = torch.arange(61.0)[:, None, None].expand(61, 22, 3)
    assert torch.allclose(resampled(ramp, 30.0, 20.0)[:, 0, 0], torch.arange(41) * 1.5, atol=1e-4)
    # Straight lines between frames would be off by 5 mm here, and add to jerk.
    for rate in (12.5, 20.0, 60.0):
        wave, expected = (torch.sin(2 * math.pi * torch.arange(2 * r + 1) / r)[:, None, None] for r in (30.0, rate))
        assert torch.allclose(resampled(wave, 30.0, rate), expected, atol=1e-3)


def write(folder, name, array):
    np.save(folder / name, array)


@pytest.mark.parametrize(
    ("spoil", "error", "message"),
    [
        (lambda f: write(f, "m-000.npy", np.full((40, 22, 3), np.nan)), FormatError, "NaN"),
        (lambda f: write(f, "m-000.npy", np.zeros((40, 24, 3))), InputError, r"not joints \(frames, 22, 3\)"),
        (lambda f: write(f, "m-000.npy", np.zeros((40, 263))), InputError, r"not joints \(frames, 22, 3\)"),
        (lambda f: write(f, "m-000.npy", np.zeros((3, 22, 3))), InputError, "at least 5"),
        (lambda f: write(f, "new.npy", np.zeros((40, 22, 3))), InputError, "new.npy has no prompt"),
        (lambda f: write(f, "m-000.npy", 1000 * np.load(f / "m-000.npy")), InputError, "give joints in metres"),
        (
            lambda f: write(f, "m-000.npy", np.zeros((40, 22, 3))),
            InputError,
            "m-000.npy holds a body whose bones are 0",
        ),
        (lambda f: (f / "prompts.jsonl").unlink(), InputError, "m-000.npy has no prompt"),
        (lambda f: (f / "prompts.jsonl").write_text("nonsense"), FormatError, "line 1"),
        (lambda f: (f / "prompts.jsonl").write_text('{"name": "000", "prompt": []}'), FormatError, "line 1"),
        (lambda f: (f / "prompts.jsonl").rename(f / "m-000.txt").write_text("a##b#0"), FormatError, "m-000.txt: "),
        (lambda f: (f / "prompts.jsonl").write_text('{"name": "000", "prompt": ""}'), FormatError, "line 1"),
        (lambda f: (f / "prompts.jsonl").write_bytes(b"\xff\xfe"), FormatError, "UTF-8"),
        (lambda f: (f / "m-000.npy").write_bytes(b"\x93NUMPY"), FormatError, "npy"),
    ],
)
def test_folders_that_cannot_be_judged(tmp_path, spoil, error, message):
    folder = motion_folder(tmp_path / "motions", 2)
    spoil(folder)
    with pytest.raises(error, match=message):
        folder_motions(folder, None, 20.0)


def test_folders_that_are_none(tmp_path):
    with pytest.raises(InputError, match="no folder"):
        folder_motions(tmp_path / "nowhere", None, 20.0)
    with pytest.raises(InputError, match=r"no \.npy files"):
        folder_motions(tmp_path, None, 20.0)


@pytest.mark.parametrize(
    ("short", "steps", "network"),
    [
        ("teacher", None, "teacher"), ("lcm", None, "lcm-1"), ("pcm", 4, "pcm-4"), ("vae", None, "vae"),
        ("rdm", 2, "rdm"), ("rdm-pcm", None, "pcm-1"), ("rdm-pcm", 1, "pcm-1"),
    ],
)  # fmt: skip
def test_short_names_mean_what_ships(short, steps, network):
    assert open_source(EvaluationConfig(model=short, steps=steps, device="cpu")).network == network


def test_jobs_open_what_they_name(bundle, streams):
    def opened(**given):
        return open_source(EvaluationConfig(device="cpu", **given))

    folder, flow = str(bundle.path), str(streams.path)
    assert opened(model=folder).slug == "tiny-pcm-1"
    assert opened(model=folder, network="vae").slug == "tiny-vae"
    assert opened(model=folder, network="teacher", steps=10).slug == "tiny-teacher-10-steps"
    assert opened(model=folder, settings=(("guidance", 1.0),), foot_lock=False).slug == "tiny-pcm-1-w1-raw"
    assert opened(model=flow).slug == "tiny-stream-pcm-1"
    assert opened(model=flow, network="rdm", settings=(("start", 2), ("shape", "triangle"))).slug == (
        "tiny-stream-rdm-start2-shapetriangle"
    )
    assert opened(model="real").slug == "real"
    with pytest.raises(InputError, match="start is a setting of streams"):
        opened(model=folder, settings=(("start", 2),))
    with pytest.raises(InputError, match="unknown model"):
        opened(model="nothing")
    with pytest.raises(InputError, match="unknown network"):
        opened(model=flow, network="teacher")
    with pytest.raises(InputError, match="a text-to-motion model is needed"):
        opened(model=flow, network="vae")
    for network in ("pcm-1", "md"):
        with pytest.raises(InputError, match=f"network '{network}' begins every segment from noise.*no triangle"):
            opened(model=flow, network=network, settings=(("shape", "triangle"),))
        assert opened(model=flow, network=network, settings=(("shape", "parallelogram"),)).network == network


def test_requests_are_within_the_limits_of_users(bundle):
    """The generator asks without ``check_request``; what it asks for must pass it."""
    for frames in (8, 40, bundle.config.max_frames):
        assert check_request(bundle.config, WALK, frames / bundle.config.fps)[0].frames == (frames,)
