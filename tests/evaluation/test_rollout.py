"""Long motion: clips in a row, windows over them, what a window is told, and what drifts."""

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from moveset.data.humanml3d import KIT
from moveset.errors import InputError
from moveset.evaluation import metrics
from moveset.evaluation.generators import Given
from moveset.evaluation.protocol import Protocol, Session
from moveset.evaluation.rollout import WINDOW, Rollout, cut, drift, rollouts, run_rollout, spread_change, starts
from moveset.evaluation.samples import open_test_set, text_of
from moveset.motion.features import get_codec
from tests.data.test_humanml3d import folder as humanml3d
from tests.evaluation.corpora import content_corpus
from tests.evaluation.judges import Oracle, Painter
from tests.motions import gait

PROTOCOL = Protocol(split="rollout", group=8)


@pytest.fixture(scope="module")
def items(tmp_path_factory):
    return open_test_set(content_corpus(tmp_path_factory.mktemp("corpus") / "corpus.safetensors", frames=90), "test")


@pytest.fixture(scope="module")
def oracle(items):
    return Oracle(items)


def draws(items, seed=0):
    return items.draw(torch.Generator().manual_seed(seed))


def test_windows_cover_a_rollout():
    assert starts(600) == [0, 98, 196, 294, 392]
    assert starts(WINDOW) == starts(50) == [0]
    joints = torch.zeros(600, 22, 3)
    assert [len(window) for window in cut(joints)] == [WINDOW + 1] * 5


def test_rollouts_are_half_a_minute_of_whole_clips(items):
    made = rollouts(draws(items), 20.0)
    assert len(made) >= 10
    for one in made:
        assert 580 <= sum(one.frames) <= 600
        assert [n for n, _ in zip(one.frames[:-1], one.draws, strict=False)] == [d.frames for d in one.draws[:-1]]
        assert one.frames[-1] >= 20
    names = [draw.item.name for one in made for draw in one.draws]
    assert len(names) == len(set(names))


def test_too_little_for_one(items):
    with pytest.raises(InputError, match="one rollout takes 30"):
        rollouts(draws(items)[:3], 20.0)


def test_windows_are_told_what_holds_longest_in_them(items):
    one = rollouts(draws(items), 20.0)[0]
    first, second = one.draws[:2]
    assert one.said(0, 60)[0] == text_of(first.caption)
    sentence, label = one.said(30, one.frames[0] + 60)
    assert label == (*first.item.label, *second.item.label)
    assert (
        sentence.lower() == f"{text_of(first.caption).rstrip('.')}, then {text_of(second.caption).rstrip('.')}".lower()
    )
    # A twentieth of a window is not told of it.
    assert one.said(5, one.frames[0] + 4)[1] == first.item.label


def test_the_real_motion_is_the_clips_in_a_row(items):
    one = rollouts(draws(items), 20.0)[0]
    joints, features = one.real(items.codec)
    assert len(joints) == sum(one.frames)
    assert [x.shape for x in features] == [(min(WINDOW, len(joints) - 1 - s), 263) for s in starts(len(joints))]


def test_real_rollouts_against_themselves(items, oracle):
    session = Session(PROTOCOL.fitted(items, False), items, Given("real"), oracle)
    found = run_rollout(session, 0)
    assert found["metrics"]["fid"] == pytest.approx(0.0, abs=1e-6)
    assert found["windows"] == sum(1 for _ in range(found["rollouts"])) * 5
    assert found["metrics"]["spread_change"] > 0
    assert {"drift_height", "drift_speed", "drift_jerk", "drift_skating", "skating"} <= set(found["metrics"])


def test_models_are_told_the_timeline(items, oracle):
    painter = Painter()
    painter.segment = 1.4
    session = Session(PROTOCOL.fitted(items, True), items, painter, oracle)
    found = run_rollout(session, 0)
    assert found == {**run_rollout(session, 0), "seconds": found["seconds"]}
    assert all(580 <= one.frames <= 600 and len(one.parts) > 3 for one in painter.asked)
    # Of single actions.
    told = {prompt for one in painter.asked for prompt, _ in one.parts}
    assert "a person walks and then waves with the left hand" not in told
    assert found["metrics"]["boundary_jerk"] > 0
    assert "multimodality" not in found["metrics"]


def test_too_few_windows_are_refused_before_anything_is_made(items, oracle):
    painter = Painter()
    session = Session(Protocol(split="rollout", group=1000), items, painter, oracle)
    with pytest.raises(InputError, match=r"windows of all rollouts: R-precision needs groups of 1000"):
        run_rollout(session, 0)
    assert not painter.asked


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda made: made[3].fill_(torch.nan), "painter gives positions that are not finite for"),
        (lambda made: made.__setitem__(0, made[0][:, :21]), r"judges \(frames, 22, 3\)"),
        (lambda made: made.__setitem__(0, made[0][:196]), "painter gives 196 frames for .*; at least 200 can be"),
    ],
)
def test_garbage_is_refused_by_its_maker_and_item(items, oracle, spoil, message):
    session = Session(PROTOCOL.fitted(items, True), items, Painter(spoil), oracle)
    with pytest.raises(InputError, match=message):
        run_rollout(session, 0)


def test_progress_adds_up(items, oracle):
    class Ticking(Painter):
        def generate(self, wanted, fps, tick=lambda count: None):
            made = super().generate(wanted, fps)
            for _ in wanted:
                tick(1)
            return made

    heard = []
    session = Session(PROTOCOL.fitted(items, True), items, Ticking(), oracle)
    found = run_rollout(session, 0, lambda *said: heard.append(said))
    count = found["rollouts"]
    assert heard[:count] == [("motions", k, count) for k in range(1, count + 1)]


@given(st.integers(0, 2**31), st.integers(40, 60), st.booleans())
def test_windows_of_one_rollout_are_not_told_apart(seed, count, labelled):
    generator = torch.Generator().manual_seed(seed)
    of = [k for k in range(count) for _ in range(5)]
    labels = torch.randint(0, 60, (len(of),), generator=generator).tolist() if labelled else list(range(len(of)))
    groups = metrics.group(labels, len(of), generator, 32)
    found = metrics.apart(groups, labels, of)
    assert [len(group) for group in found] == [32] * len(groups)
    assert len({window for group in found for window in group}) == 32 * len(groups)
    for group in found:
        assert len({labels[window] for window in group}) == 32
    before, after = (sum(32 - len({of[k] for k in group}) for group in some) for some in (groups, found))
    assert after <= before / 4
    if not labelled:
        assert after == 0


def test_groups_of_different_rollouts_stay_as_they_were():
    groups, labels = [[0, 3, 4], [5, 8, 2]], list(range(9))
    assert metrics.apart(groups, labels, [k // 2 for k in range(9)]) == groups
    assert metrics.apart([[0, 1, 4], [5, 8, 3]], labels, [k // 2 for k in range(9)]) != [[0, 1, 4], [5, 8, 3]]


def test_a_caption_with_tokens_is_read_with_them(tmp_path):
    folder = humanml3d(tmp_path, KIT, {f"{k}": 230 for k in range(3)}, test=["0", "1", "2"])
    long = open_test_set(folder, "test", long=True)
    (draw, *_) = draws(long)
    assert Rollout((draw,), (230,)).said(0, WINDOW)[0] == draw.caption
    assert draw.caption.tokens


def test_what_sinks_drifts():
    steady = gait(600).joints
    sinking = steady - torch.linspace(0, 0.5, 600)[:, None, None] * torch.tensor((0.0, 1.0, 0.0))
    codec = get_codec("hml")
    assert abs(drift([steady], codec)["drift_height"]) < 0.01
    assert drift([sinking], codec)["drift_height"] == pytest.approx(-1.0, abs=0.05)  # metres a minute


def test_spread_that_shrinks():
    points = torch.randn(10, 4, 8, dtype=torch.float64)
    points[:, -1] = 0.1 * points[:, 0]
    assert spread_change(points.flatten(0, 1), [4] * 10) == pytest.approx(0.1)
